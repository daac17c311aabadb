"""AMASS and BVH as motion sets: what is read back is what went in."""

import numpy as np
import pytest
import torch

pytest.importorskip("pybvh")
import pybvh

from posed_mocap import bvh, convert
from posed_mocap.clips import load_set
from posed_mocap.rotations import quat_to_matrix
from posed_mocap.skeleton import JOINT_NAMES, forward_kinematics

A_POSE = 0.7
"""How far the arms of the rig below hang at rest: the sine and cosine of 45 degrees."""


def rig(toes=True, spines=3):
    """Joint: (parent, offset in centimetres), facing +Z with the arms half lowered."""
    joints = {"Hips": (None, (0, 0, 0))}
    parent = "Hips"
    for number in range(spines):
        name = "Spine" + (str(number) if number else "")
        joints[name] = (parent, (0, 36 / spines, 0))
        parent = name
    joints["Neck"] = (parent, (0, 20, -2))
    joints["Head"] = ("Neck", (0, 9, 4))
    for side, x in (("Left", 1), ("Right", -1)):
        joints[f"{side}Shoulder"] = (parent, (x * 6, 12, 0))
        joints[f"{side}Arm"] = (f"{side}Shoulder", (x * 12, 0, 0))
        joints[f"{side}ForeArm"] = (f"{side}Arm", (x * 26 * A_POSE, -26 * A_POSE, 0))
        joints[f"{side}Hand"] = (f"{side}ForeArm", (x * 25 * A_POSE, -25 * A_POSE, 0))
        joints[f"{side}UpLeg"] = ("Hips", (x * 9, -6, 0))
        joints[f"{side}Leg"] = (f"{side}UpLeg", (0, -41, 1))
        joints[f"{side}Foot"] = (f"{side}Leg", (0, -40, -2))
        if toes:
            joints[f"{side}ToeBase"] = (f"{side}Foot", (0, -6, 13))
    return joints


def write_bvh(path, joints, frames=40, seed=0):
    """A rig that moves every joint, at 30 frames a second."""
    order = []

    def block(name, depth):
        order.append(name)
        pad = "  " * depth
        kind = "ROOT" if depth == 0 else "JOINT"
        position = "Xposition Yposition Zposition " if depth == 0 else ""
        lines = [f"{pad}{kind} {name}", pad + "{", f"{pad}  OFFSET {'%g %g %g' % joints[name][1]}",
                 f"{pad}  CHANNELS {6 if depth == 0 else 3} {position}Zrotation Xrotation Yrotation"]
        children = [child for child, (parent, _) in joints.items() if parent == name]
        for child in children:
            lines += block(child, depth + 1)
        if not children:
            lines += [f"{pad}  End Site", pad + "  {", f"{pad}    OFFSET 0 0 5", pad + "  }"]
        return lines + [pad + "}"]

    lines = ["HIERARCHY", *block("Hips", 0), "MOTION", f"Frames: {frames}", "Frame Time: 0.0333333"]
    random = np.random.default_rng(seed)
    swing, phase = random.uniform(5, 40, (len(order), 3)), random.uniform(0, 6, (len(order), 3))
    for frame in range(frames):
        turns = swing * np.sin(frame / 9 + phase)
        place = [3 * frame / 10, 95 + np.sin(frame / 7), -frame / 5]
        lines.append(" ".join(f"{value:.5f}" for value in [*place, *turns.ravel()]))
    path.write_text("\n".join(lines) + "\n")
    return path


def places(clip):
    """World positions (frames, 22, 3) in posed's frame."""
    local = quat_to_matrix(torch.from_numpy(clip.quats))
    _, position = forward_kinematics(local, torch.from_numpy(clip.offsets))
    return position.numpy() + clip.root[:, None]


RIG_NAMES = {
    "pelvis": "Hips", "spine1": "Spine", "spine2": "Spine1", "spine3": "Spine2", "neck": "Neck",
    "head": "Head", "left_hip": "LeftUpLeg", "right_knee": "RightLeg", "left_ankle": "LeftFoot",
    "right_foot": "RightToeBase", "left_collar": "LeftShoulder", "right_shoulder": "RightArm",
    "left_elbow": "LeftForeArm", "left_wrist": "LeftHand", "right_wrist": "RightHand",
}


def test_a_bvh_motion_keeps_its_joints_places(tmp_path):
    path = write_bvh(tmp_path / "walk.bvh", rig())
    clip = bvh.load_file(path)
    assert len(clip.root) == 79 and clip.name == "walk", "30 frames a second became 60"
    motion = pybvh.read_bvh_file(str(path), world_up="+y")
    theirs = motion.node_positions()[:, [motion.node_index[n] for n in RIG_NAMES.values()]]
    ours = places(clip)[::2, [JOINT_NAMES.index(name) for name in RIG_NAMES]]
    # Centimetres, facing +Z; posed's world is metres and faces -Z.
    assert np.abs(ours - theirs * [-0.01, 0.01, -0.01]).max() < 1e-4


def test_the_t_pose_has_no_rotations_whatever_the_rest_pose(tmp_path):
    joints = rig()
    path = write_bvh(tmp_path / "t.bvh", joints, frames=5)
    lines = path.read_text().splitlines()
    names = [line.split()[1] for line in lines if "ROOT" in line or "JOINT" in line]
    row = np.zeros(3 + 3 * len(names))
    row[1] = 95
    for name, degrees in (("LeftArm", 45), ("RightArm", -45)):
        row[3 + 3 * names.index(name)] = degrees
    legs = np.degrees(np.arctan2([1, -2], [41, 40]))
    for side in ("Left", "Right"):
        row[3 + 3 * names.index(f"{side}UpLeg") + 1] = legs[0]
        row[3 + 3 * names.index(f"{side}Leg") + 1] = legs[1] - legs[0]
        row[3 + 3 * names.index(f"{side}Foot") + 1] = -legs[1]
    text = " ".join(f"{value:.7f}" for value in row)
    path.write_text("\n".join([*lines[:-5], *[text] * 5]) + "\n")
    clip = bvh.load_file(path)
    assert np.abs(np.abs(clip.quats[..., 3]) - 1).max() < 1e-6
    left_arm = clip.offsets[[18, 20]]
    assert np.abs(left_arm[:, 1:]).max() < 1e-5 and left_arm[0, 0] < -0.25


def test_a_poorer_rig_is_filled_up_and_a_strange_one_refused(tmp_path):
    clip = bvh.load_file(write_bvh(tmp_path / "poor.bvh", rig(toes=False, spines=1)))
    assert 1.2 < clip.head_height < 1.6
    assert np.allclose(clip.quats[:, [3, 6]], [0, 0, 0, 1]), "spines that the rig lacks are rigid"
    strange = {name.replace("LeftHand", "LeftPaw"): bone for name, bone in rig().items()}
    with pytest.raises(ValueError, match="left_wrist"):
        bvh.load_file(write_bvh(tmp_path / "strange.bvh", strange))


def test_names_of_common_rigs_are_understood():
    for name, told in {
        "mixamorig:LeftUpLeg": ("left", "upleg"), "upperarm_r": ("right", "upperarm"),
        "hip.L": ("left", "hip"), "lThigh": ("left", "thigh"), "Spine1": (None, "spine1"),
        "right_wrist": ("right", "wrist"), "LHipJoint": ("left", "hipjoint"), "Neck": (None, "neck"),
    }.items():
        assert bvh.side_and_name(name) == told


def test_what_is_converted_reads_back(tmp_path, capsys):
    folder = tmp_path / "in"
    folder.mkdir()
    write_bvh(folder / "a.bvh", rig())
    poses = np.zeros((240, 156))
    poses[:, 0] = np.pi / 2
    poses[:, 54] = np.linspace(0, 1, 240)
    np.savez(folder / "b_poses.npz", poses=poses, trans=np.zeros((240, 3)), mocap_framerate=120.0)
    (folder / "c.bvh").write_text("not a motion\n")
    out = tmp_path / "set.npz"
    assert convert.main([str(out), str(folder), "--split", "val"]) == 1, "one file was left out"
    assert "c.bvh" in capsys.readouterr().err
    with np.load(out) as data:
        assert all(not np.isfortran(data[name]) for name in data.files), "posed reads C order"
        assert data["root"].dtype == np.float32 and data["fps"].shape == ()
    clips = list(load_set(out, {"val"}))
    assert [clip.name for clip in clips] == ["a", "b_poses"]
    for clip, file in zip(clips, ("a.bvh", "b_poses.npz"), strict=True):
        original = convert.load(folder / file, "val", None)
        assert np.abs(places(clip) - places(original)).max() < 5e-4
        assert clip.head_height == pytest.approx(original.head_height)


def test_nothing_to_convert_is_an_error(tmp_path):
    with pytest.raises(SystemExit, match="nothing to convert"):
        convert.main([str(tmp_path / "set.npz"), str(tmp_path)])
