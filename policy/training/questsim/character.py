"""The physics character as arrays, and forward kinematics of many of them at once.

The MJCF comes from Rust (`references`), which is its one definition. Arrays are (worlds, ...);
links and hinges are in the order of the document's bodies and joints.
"""

from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np

LINKS = 16
HINGES = 33
PELVIS, HEAD, LEFT_HAND, RIGHT_HAND, LEFT_FOOT, RIGHT_FOOT = 0, 3, 6, 9, 12, 15
LEGS = (slice(21, 27), slice(27, 33))
"""The hinges of the left and the right leg."""
FEET = (LEFT_FOOT, RIGHT_FOOT)


@dataclass
class Character:
    """One person's character."""

    model: mujoco.MjModel
    stature: float

    @classmethod
    def from_mjcf(cls, text, stature):
        model = mujoco.MjModel.from_xml_string(text)
        if model.nbody < LINKS + 1 or model.njnt < HINGES + 1 or model.nu != HINGES:
            raise ValueError(f"this MJCF has {model.njnt} joints and {model.nu} motors: "
                             f"it is not the {HINGES}-hinge character")
        return cls(model, float(stature))

    @cached_property
    def offsets(self):
        """(16, 3): each link's joint in its parent's frame, metres."""
        offsets = self.model.body_pos[1:LINKS + 1].copy()
        offsets[0] = 0
        return offsets

    @cached_property
    def parents(self):
        return [int(p) - 1 for p in self.model.body_parentid[1:LINKS + 1]]

    @cached_property
    def axes(self):
        """(33, 3): each hinge's axis in its link's frame."""
        return self.model.jnt_axis[1:HINGES + 1].copy()

    def link_of(self, hinge):
        """The link that a hinge turns."""
        return next(link for link, own in enumerate(self.hinges) if hinge in own)

    @cached_property
    def hinges(self):
        """For each link: its range of hinges."""
        body = self.model.jnt_bodyid[1:HINGES + 1] - 1
        return [np.flatnonzero(body == link).tolist() for link in range(LINKS)]

    @cached_property
    def torque(self):
        """(33,): greatest torques, N m."""
        return self.model.actuator_ctrlrange[:HINGES, 1].copy()

    @cached_property
    def ranges(self):
        """(33, 2): least and greatest angles."""
        return self.model.jnt_range[1:HINGES + 1].copy()

    @cached_property
    def sole_points(self):
        """(2, 4, 3): the corners of each sole in its foot's frame: heel and ball, two sides."""
        feet = []
        for name in ("left_foot", "right_foot"):
            corners = []
            for side in ("inner", "outer"):
                geom = self.model.geom(f"{name}_{side}")
                half, radius = geom.size[1], geom.size[0]
                turn = np.zeros(9)
                mujoco.mju_quat2Mat(turn, geom.quat)
                axis = turn.reshape(3, 3)[:, 2]
                for end in (-half, half):
                    corners.append(geom.pos + axis * end - np.array([0, radius, 0]))
            feet.append(corners)
        return np.array(feet)


@dataclass
class Frames:
    """Links of many worlds, all in the world's axes."""

    position: np.ndarray
    """(n, 16, 3) of each link's joint, metres."""
    rotation: np.ndarray
    """(n, 16, 3, 3) link to world."""
    linear: np.ndarray
    """(n, 16, 3) velocity of the link's joint, m/s."""
    angular: np.ndarray
    """(n, 16, 3) rad/s."""
    axes: np.ndarray
    """(n, 33, 3) hinge axes."""


def quat_to_matrix(q):
    """(..., 4) x, y, z, w to (..., 3, 3)."""
    x, y, z, w = np.moveaxis(q, -1, 0)
    rows = [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
            2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
            2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]
    return np.stack(rows, -1).reshape(*q.shape[:-1], 3, 3)


def skew(v):
    """(..., 3) to (..., 3, 3) with skew(v) u = v x u."""
    zero = np.zeros_like(v[..., 0])
    x, y, z = np.moveaxis(v, -1, 0)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*v.shape[:-1], 3, 3)


def rotate(matrix, vector):
    """(..., 3, 3) on (..., 3)."""
    return (matrix @ vector[..., None])[..., 0]


def rotation_log(matrix):
    """Rotation vectors (..., 3) of (..., 3, 3), for angles below about 170 degrees."""
    vector = 0.5 * np.stack([matrix[..., 2, 1] - matrix[..., 1, 2],
                             matrix[..., 0, 2] - matrix[..., 2, 0],
                             matrix[..., 1, 0] - matrix[..., 0, 1]], -1)
    sine = np.linalg.norm(vector, axis=-1, keepdims=True)
    cosine = 0.5 * (np.trace(matrix, axis1=-2, axis2=-1)[..., None] - 1)
    angle = np.arctan2(sine, cosine)
    return vector * np.where(sine < 1e-6, 1.0, angle / np.maximum(sine, 1e-9))


def rotation_exp(vector):
    """The inverse of `rotation_log`."""
    angle = np.linalg.norm(vector, axis=-1)[..., None, None]
    k = skew(vector)
    small = angle < 1e-6
    safe = np.where(small, 1.0, angle)
    one = np.where(small, 1.0, np.sin(safe) / safe)
    two = np.where(small, 0.5, (1 - np.cos(safe)) / safe**2)
    return np.eye(3) + one * k + two * (k @ k)


def forward(character, offsets, qpos, qvel):
    """Places every link of many worlds.

    character: any with the same topology; offsets (n, 16, 3) of each world's own; qpos (n, 40)
    and qvel (n, 39) in MuJoCo's order.
    """
    n = len(qpos)
    axes, angles, rates = character.axes, qpos[:, 7:7 + HINGES], qvel[:, 6:6 + HINGES]
    k = skew(axes)
    sine, cosine = np.sin(angles)[..., None, None], np.cos(angles)[..., None, None]
    turns = np.eye(3) + sine * k + (1 - cosine) * (k @ k)
    position, linear = np.empty((n, LINKS, 3)), np.empty((n, LINKS, 3))
    rotation, angular = np.empty((n, LINKS, 3, 3)), np.empty((n, LINKS, 3))
    world_axes = np.empty((n, HINGES, 3))
    quat = qpos[:, [4, 5, 6, 3]]
    position[:, 0], linear[:, 0] = qpos[:, :3], qvel[:, :3]
    rotation[:, 0] = quat_to_matrix(quat / np.linalg.norm(quat, axis=-1, keepdims=True))
    angular[:, 0] = rotate(rotation[:, 0], qvel[:, 3:6])
    for link in range(1, LINKS):
        parent = character.parents[link]
        arm = rotate(rotation[:, parent], offsets[:, link])
        position[:, link] = position[:, parent] + arm
        linear[:, link] = linear[:, parent] + np.cross(angular[:, parent], arm)
        turn, spin = rotation[:, parent], angular[:, parent].copy()
        for hinge in character.hinges[link]:
            world_axes[:, hinge] = turn @ axes[hinge]
            spin += world_axes[:, hinge] * rates[:, hinge, None]
            turn = turn @ turns[:, hinge]
        rotation[:, link], angular[:, link] = turn, spin
    return Frames(position, rotation, linear, angular, world_axes)
