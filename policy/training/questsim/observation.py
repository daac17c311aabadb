"""The observation of QuestSim (sections 3.3, 3.5, 3.6): 312 + 162 + 1 numbers.

312: 33 angles, 33 rates, then of the 16 links, each a block of its own: positions (3), rotations
(6: first and second column), the forces on the left and the right foot (3 each, N), linear and
angular velocities (3 each). 162: six frames after the present one, each head, left wrist, right
wrist with position (3) and rotation (6). 1: stature, metres. Everything is in frame S: on the
floor under the pelvis, turned by its heading. `policy/tracker/src/questsim/observation.rs` is the
same; golden vectors hold both to it.
"""

import numpy as np

from .character import rotate, rotation_exp, rotation_log

RATE = 36.0
"""Policy steps a second."""
SUBSTEPS = 4
FUTURE = 6
"""Frames of the user that the policy sees."""
PARTS = 3
SIM, USER = 312, 162
SIZE = SIM + USER + 1
CARRY_S = 0.2
"""A velocity that is carried beyond the newest frame decays with this time constant, seconds."""


def heading(rotation):
    """Heading of (n, 3, 3) pelvis rotations: the twist about +Y, radians."""
    return np.arctan2(rotation[:, 0, 2] - rotation[:, 2, 0],
                      rotation[:, 0, 0] + rotation[:, 2, 2])


def frame_s(position, rotation):
    """Origin (n, 3) of frame S and the rotation (n, 3, 3) from the world into it."""
    angle = heading(rotation)
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    into = np.stack([c, zero, -s, zero, one, zero, s, zero, c], -1).reshape(-1, 3, 3)
    origin = position * np.array([1.0, 0.0, 1.0])
    return origin, into


def six(rotation):
    """First, then second column of (..., 3, 3)."""
    return np.concatenate([rotation[..., :, 0], rotation[..., :, 1]], -1)


def future_parts(position, rotation, lookahead):
    """What is known of the six frames to come.

    position (n, 8, 3, 3) and rotation (n, 8, 3, 3, 3): the frame before, the present one and six
    after it, each of three parts. lookahead (n,): so many frames after the present one have been
    measured; the others are carried on from the last two of those. Gives (n, 6, ...) each.
    """
    out_p, out_r = position[:, 2:].copy(), rotation[:, 2:].copy()
    for known in np.unique(lookahead):
        rows = np.flatnonzero(lookahead == known)
        last = int(known) + 1
        velocity = (position[rows, last] - position[rows, last - 1]) * RATE
        spin = rotation_log(
            rotation[rows, last] @ np.swapaxes(rotation[rows, last - 1], -1, -2)) * RATE
        for frame in range(int(known) + 1, FUTURE + 1):
            ahead = (frame - known) / RATE
            span = CARRY_S * (1 - np.exp(-ahead / CARRY_S))
            out_p[rows, frame - 1] = position[rows, last] + velocity * span
            out_r[rows, frame - 1] = rotation_exp(spin * span) @ rotation[rows, last]
    return out_p, out_r


def observe(frames, qpos, qvel, feet, parts_p, parts_r, hands, stature):
    """The observation (n, 475).

    frames: of `forward`; feet (n, 2, 3) forces in the world; parts_p (n, 6, 3, 3) and parts_r (n,
    6, 3, 3, 3) of `future_parts`; hands (n,) bool: whether controllers are there, zeros stand for
    them otherwise; stature (n,).
    """
    n = len(qpos)
    origin, into = frame_s(frames.position[:, 0], frames.rotation[:, 0])
    turn = into[:, None]
    user_p = rotate(into[:, None, None], parts_p - origin[:, None, None])
    user = np.concatenate([user_p, six(into[:, None, None] @ parts_r)], -1)
    user[:, :, 1:] *= hands[:, None, None, None]
    return np.concatenate([
        qpos[:, 7:40], qvel[:, 6:39],
        rotate(turn, frames.position - origin[:, None]).reshape(n, -1),
        six(turn @ frames.rotation).reshape(n, -1),
        rotate(turn, feet).reshape(n, -1),
        rotate(turn, frames.linear).reshape(n, -1),
        rotate(turn, frames.angular).reshape(n, -1),
        user.reshape(n, -1), stature[:, None],
    ], 1)
