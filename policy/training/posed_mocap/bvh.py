"""BVH files as clips on the 22-joint skeleton.

Read by pybvh. Joints are found by the names that common rigs give them. Every limb is turned from
the rig's rest pose (T, A or arms hanging) to the T-pose in which the skeleton's rotations are the
identity; the rest pose has to stand upright, as rest poses do.
"""

import re
from pathlib import Path

import numpy as np
import pybvh
from scipy.spatial.transform import Rotation

from .clips import Clip, resample, to_posed_frame
from .skeleton import JOINT_NAMES, JOINTS, PARENTS

SIDED = {
    "hip": "upleg upperleg thigh legupper hip",
    "knee": "knee leg lowleg lowerleg shin calf leglower",
    "ankle": "ankle foot",
    "foot": "toe toebase toes ball toe0 foot",
    "wrist": "wrist hand",
    "elbow": "elbow forearm lowarm lowerarm armlower",
    "shoulder": "arm uparm upperarm armupper shoulder",
    "collar": "collar clavicle shoulder shoulderblade",
}
"""What rigs call the joints of a limb. A name that fits two joints is that of the first, unless
the first has another of its own: `LeftShoulder` is the collar bone where there is a `LeftArm`."""
CENTRE = {
    "pelvis": "pelvis hips hip root",
    "neck": "neck neck0 neck1",
    "head": "head",
}
SPINE = re.compile(r"(spine|chest|torso|abdomen|upperchest|lowerback|thorax|ribcage)[0-9]*")
UNITS = [1.0, 0.01, 0.0254, 0.001, 0.0254 / 0.45]
"""Metres a unit: metres, centimetres, inches, millimetres, the ASF length of CMU's files."""
HEAD_HEIGHTS = (1.0, 2.0)
"""A grown person's T-pose head joint is this far above the toes, metres."""


def side_and_name(name):
    """`mixamorig:LeftUpLeg` as ("left", "upleg"); the side is None for joints of the middle."""
    plain = re.sub(r"^.*[:|]", "", name)
    words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])|[ _.\-]+", " ", plain).lower().split()
    for side, marks in (("left", ("left", "l")), ("right", ("right", "r"))):
        for at in (0, -1):
            if len(words) > 1 and words[at] in marks:
                rest = words[1:] if at == 0 else words[:-1]
                return side, "".join(rest)
    joined = "".join(words)
    for side in ("left", "right"):
        if joined.startswith(side):
            return side, joined[len(side):]
    # "LHipJoint", "rThigh": one letter before a capital.
    if re.match(r"[lrLR][A-Z]", plain):
        return {"l": "left", "r": "right"}[plain[0].lower()], plain[1:].lower()
    return None, joined


def find_joints(names):
    """The rig's joint for each of the skeleton's, by index; None for those that it lacks.

    Raises ValueError naming a joint that no skeleton can do without.
    """
    told = [side_and_name(name) for name in names]
    found = {}
    for joint, aliases in CENTRE.items():
        for alias in aliases.split():
            if (None, alias) in told:
                found.setdefault(joint, told.index((None, alias)))
    for side in ("left", "right"):
        for limb in (("hip", "knee", "ankle", "foot"), ("wrist", "elbow", "shoulder", "collar")):
            taken = set()
            for joint in limb:
                for alias in SIDED[joint].split():
                    at = told.index((side, alias)) if (side, alias) in told else None
                    if at is not None and at not in taken:
                        found[f"{side}_{joint}"] = at
                        taken.add(at)
                        break
    spine = [i for i, (side, name) in enumerate(told) if side is None and SPINE.fullmatch(name)]
    if spine:
        # The lowest, the highest, and one between where there are three and more.
        found["spine1"], found["spine3"] = spine[0], spine[-1]
        if len(spine) > 2:
            found["spine2"] = spine[len(spine) // 2]
        if len(spine) == 1:
            del found["spine1"]
    for joint in JOINT_NAMES:
        dispensable = joint.startswith("spine") or joint.endswith(("collar", "foot", "neck"))
        if joint not in found and not dispensable:
            raise ValueError(f"no joint of the rig is known as {joint}; it has {', '.join(names)}")
    return [found.get(joint) for joint in JOINT_NAMES]


def rest_places(rig_places, found):
    """Rest positions of the 22 joints: missing ones lie evenly between those around them."""
    places = np.full((JOINTS, 3), np.nan)
    for joint, at in enumerate(found):
        if at is not None:
            places[joint] = rig_places[at]
    for chain in ([0, 3, 6, 9, 12, 15], [9, 13, 16], [9, 14, 17]):
        known = [i for i, joint in enumerate(chain) if not np.isnan(places[joint, 0])]
        for axis in range(3):
            values = [places[chain[i], axis] for i in known]
            places[chain, axis] = np.interp(range(len(chain)), known, values)
    return places


def upright(places):
    """The turn from the rig's axes to left +X, up +Y, forward +Z, from its rest pose."""
    left = places[1] - places[2]
    up = places[15] - places[0]
    left = left / np.linalg.norm(left)
    up = up - left * up.dot(left)
    up = up / np.linalg.norm(up)
    # Rest poses stand straight along an axis of their file; hips and spine may lean a little.
    return snap(np.stack([left, up, np.cross(left, up)]))


def snap(axes):
    """The nearest turn that takes axes to axes, if it is within 15 degrees; else `axes`."""
    straight = np.zeros((3, 3))
    for row in (0, 1):
        at = np.argmax(np.abs(axes[row]))
        straight[row, at] = np.sign(axes[row, at])
    straight[2] = np.cross(straight[0], straight[1])
    apart = Rotation.from_matrix(straight @ axes.T).magnitude()
    return straight if apart < np.radians(15) else axes


LIMBS = [
    ([1, 4], [0, -1, 0]), ([2, 5], [0, -1, 0]), ([16, 18], [1, 0, 0]), ([17, 19], [-1, 0, 0]),
]
"""Joints whose bone to their child has a direction in the T-pose; what hangs on goes along."""


def rest_turns(places):
    """For each joint the turn from the T-pose to the rig's rest pose."""
    turns = [Rotation.identity()] * JOINTS
    for joints, direction in LIMBS:
        for joint in joints:
            child = PARENTS.index(joint)
            bone = places[child] - places[joint]
            turns[joint] = between(np.array(direction, float), bone / np.linalg.norm(bone))
    for hand, forearm in ((20, 18), (21, 19)):
        turns[hand] = turns[forearm]
    return turns


def between(a, b):
    """The shortest turn from one unit vector to another."""
    axis = np.cross(a, b)
    sine, cosine = np.linalg.norm(axis), a.dot(b)
    if sine < 1e-9:
        return Rotation.identity() if cosine > 0 else Rotation.from_rotvec([0, np.pi, 0])
    return Rotation.from_rotvec(axis / sine * np.arctan2(sine, cosine))


def world_rotations(motion):
    """World rotations of every joint of the rig, in the order of `motion.joint_names`."""
    names = motion.joint_names
    index = {name: i for i, name in enumerate(names)}
    joints = [node for node in motion.nodes if not node.is_end_site()]
    angles = motion.joint_angles
    world = []
    for i, (node, order) in enumerate(zip(joints, motion.euler_orders, strict=True)):
        local = Rotation.from_euler(order, angles[:, i])
        world.append(local if node.parent is None else world[index[node.parent.name]] * local)
    return world


def unit_of(places):
    """Metres a unit, guessed from how tall the rest pose is."""
    height = places[15, 1] - places[[10, 11], 1].min()
    for unit in UNITS:
        if HEAD_HEIGHTS[0] <= height * unit <= HEAD_HEIGHTS[1]:
            return unit
    raise ValueError(f"the rest pose is {height:.3g} units tall to the head: give --scale")


def load_file(path, split="test", scale=None):
    """One BVH file as a clip at 60 Hz; `scale` is metres a unit, guessed where it is None."""
    motion = pybvh.read_bvh_file(str(path), world_up="+y", warn_on_world_up_disagreement=False)
    nodes = [i for i, node in enumerate(motion.nodes) if not node.is_end_site()]
    rig_places = motion.rest_pose_positions()[nodes]
    found = find_joints(motion.joint_names)
    places = rest_places(rig_places, found)
    axes = upright(places)
    places = places @ axes.T
    for toe, ankle in ((10, 7), (11, 8)):
        if np.isnan(places[toe, 0]):
            # A rig without toes: a foot of a usual length, level.
            shank = np.linalg.norm(places[ankle] - places[PARENTS[ankle]])
            places[toe] = places[ankle] + shank * np.array([0, -0.14, 0.32])
    scale = scale or unit_of(places)
    places = places * scale
    turns = rest_turns(places)
    offsets = np.zeros((JOINTS, 3), np.float32)
    for joint, parent in enumerate(PARENTS[1:], 1):
        offsets[joint] = turns[parent].inv().apply(places[joint] - places[parent])
    quats = local_quats(world_rotations(motion), found, Rotation.from_matrix(axes), turns)
    root = motion.node_positions()[:, nodes[found[0]]] @ axes.T * scale
    quats, root = resample(quats, root, 1.0 / motion.frame_time)
    heights = np.zeros(JOINTS)
    for joint, parent in enumerate(PARENTS[1:], 1):
        heights[joint] = heights[parent] + offsets[joint, 1]
    quats, root, offsets = to_posed_frame(quats, root, offsets)
    head_height = float(heights[15] - heights[[10, 11]].min())
    return Clip(Path(path).stem, "bvh", split, quats, root, offsets, head_height)


def local_quats(world, found, axes, turns):
    """Local quaternions (frames, 22, 4) from the rig's world rotations.

    The rig's rest pose has no rotations: in the T-pose a limb has turned back from it.
    """
    turned = [None] * JOINTS
    for joint, at in enumerate(found):
        if at is not None:
            turned[joint] = axes * world[at] * axes.inv() * turns[joint]
        else:
            turned[joint] = turned[PARENTS[joint]]
    local = [turned[0]]
    local += [turned[PARENTS[joint]].inv() * turned[joint] for joint in range(1, JOINTS)]
    return np.stack([rotation.as_quat() for rotation in local], axis=1).astype(np.float32)
