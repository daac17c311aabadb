"""Reference motion on the physics character, from the files that Rust's `references` writes."""

import os
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from .balance import CARRIES, accelerations, balance, zero_moment_point
from .character import (LEFT_FOOT, LINKS, RIGHT_FOOT, Character, forward, quat_to_matrix,
                        rotate, rotation_log)
from .observation import RATE

SOLE_DEPTH_QUANTILE = 10
"""Clips are set on the floor by this percentile of their lowest sole corner."""
STANDS_HEIGHT, STANDS_SPEED = 0.035, 0.5
"""A foot of the reference stands while one of its corners is below and slower than these."""
CARRIED = 0.4
"""With this share of gravity or more under it a body is carried: one foot stands."""
GROUND_REACH = 0.06
"""Sole corners below this can carry weight in the feasibility test, metres."""
ZMP_SLACK = 0.12
"""How far outside the support the zero-moment point of a frame may lie, metres."""
INFEASIBLE_SHARE = 0.15
"""Clips with a larger share of frames that no contact force explains are dropped."""


@dataclass
class Motion:
    """Clips, frame after frame at 36 Hz."""

    characters: list
    mjcf: list
    """The document of each character."""
    stature: np.ndarray
    """(characters,) metres."""
    start: np.ndarray
    character: np.ndarray
    """(clips,) index into `characters`."""
    names: list
    qpos: np.ndarray
    """(frames, 40) as MuJoCo has it."""
    qvel: np.ndarray
    """(frames, 39)."""
    links: np.ndarray
    """(frames, 16, 3) positions of the links, metres."""
    speeds: np.ndarray
    """(frames, 16, 3) their velocities."""
    stands: np.ndarray
    """(frames, 2) bool: which feet stand."""
    foot_rotation: np.ndarray
    """(frames, 2, 3, 3) of the feet."""
    foot_spin: np.ndarray
    """(frames, 2, 3) angular velocities of the feet in the world, rad/s."""
    parts_p: np.ndarray
    """(frames, 3, 3) head, left and right wrist."""
    parts_r: np.ndarray
    """(frames, 3, 3, 3)."""
    strain: np.ndarray
    """(clips,) share of frames that no contact force explains."""

    def __len__(self):
        return len(self.start) - 1

    def length(self, clip):
        return self.start[clip + 1] - self.start[clip]


    def save(self, path):
        """Writes everything, atomically."""
        arrays = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "characters"}
        partial = Path(path).with_suffix(".part.npz")
        np.savez(partial, **arrays)
        os.replace(partial, path)

    @classmethod
    def read(cls, path):
        """The inverse of `save`."""
        with np.load(path, allow_pickle=False) as data:
            arrays = {key: data[key] for key in data.files}
        arrays["names"] = [str(name) for name in arrays["names"]]
        arrays["mjcf"] = [str(text) for text in arrays["mjcf"]]
        made = [Character.from_mjcf(*pair) for pair in zip(arrays["mjcf"], arrays["stature"])]
        return cls(characters=made, **arrays)


def texts(rows):
    """Rows of zero-padded bytes as strings."""
    return [bytes(row).rstrip(b"\0").decode() for row in rows]


def velocities(qpos):
    """(frames, 39) in MuJoCo's order by central differences of (frames, 40)."""
    count = len(qpos)
    root, rotation, angles = qpos[:, :3], qpos[:, [4, 5, 6, 3]], qpos[:, 7:]
    before = np.maximum(np.arange(count) - 1, 0)
    after = np.minimum(np.arange(count) + 1, count - 1)
    span = ((after - before) / RATE)[:, None]
    matrix = quat_to_matrix(rotation)
    turn = rotation_log(np.swapaxes(matrix[before], -1, -2) @ matrix[after])
    # The turn is in the earlier frame's axes; halfway there it is nearly the same vector.
    return np.concatenate([
        (root[after] - root[before]) / span, turn / span, (angles[after] - angles[before]) / span,
    ], 1)


def sole_corners(character, frames):
    """(n, 2, 4, 3) in the world."""
    points = character.sole_points
    feet = [LEFT_FOOT, RIGHT_FOOT]
    turned = rotate(frames.rotation[:, feet, None], points[None])
    return frames.position[:, feet, None] + turned


def unexplained(character, qpos, qvel, corners):
    """(frames,) bool: no force of the ground on the soles moves the character like this."""
    point, load = zero_moment_point(character, qpos, qvel, accelerations(qvel, RATE))
    near = corners.reshape(len(qpos), -1, 3)
    down = (near[..., 1] < GROUND_REACH)[..., None]
    # Without a corner near the floor nothing lies between these.
    low = np.where(down, near, np.inf).min(1)[:, [0, 2]] - ZMP_SLACK
    high = np.where(down, near, -np.inf).max(1)[:, [0, 2]] + ZMP_SLACK
    return (load >= CARRIES) & ~((low <= point) & (point <= high)).all(1)


def load(path, wanted=lambda name: True, feasible=True, longest=None):
    """Reads the clips whose name is wanted; infeasible ones are dropped unless told otherwise."""
    with np.load(path, allow_pickle=False) as data:
        arrays = {key: data[key] for key in data.files}
    names, mjcf = texts(arrays["name"]), texts(arrays["mjcf"])
    characters, known, kept_mjcf = [], {}, []
    keep = []
    for clip, name in enumerate(names):
        if not wanted(name):
            continue
        index = int(arrays["character"][clip])
        if index not in known:
            known[index] = len(characters)
            kept_mjcf.append(mjcf[index])
            characters.append(Character.from_mjcf(mjcf[index], arrays["stature"][clip]))
        a, b = arrays["start"][clip], arrays["start"][clip + 1]
        b = b if longest is None else min(b, a + longest)
        made = one(characters[known[index]], *(arrays[k][a:b].astype(np.float64)
                                               for k in ("root", "rotation", "angles", "parts")))
        if feasible and made["strain"] > INFEASIBLE_SHARE:
            continue
        keep.append((name, known[index], made))
    if not keep:
        raise ValueError(f"{path}: no clip is left to train on")
    join = {key: np.concatenate([made[key] for *_, made in keep])
            for key in keep[0][2] if key != "strain"}
    lengths = [len(made["qpos"]) for *_, made in keep]
    return Motion(
        mjcf=kept_mjcf, stature=np.array([c.stature for c in characters]),
        characters=characters, start=np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64),
        character=np.array([c for _, c, _ in keep]), names=[n for n, *_ in keep],
        strain=np.array([made["strain"] for *_, made in keep]), **join)


def standing(frames, corners, qvel):
    """(frames, 2) bool: which feet stand, flat, on the heel or on the toes."""
    feet = [LEFT_FOOT, RIGHT_FOOT]
    arms = corners - frames.position[:, feet, None]
    moving = frames.linear[:, feet, None] + np.cross(frames.angular[:, feet, None], arms)
    speed = np.linalg.norm(moving, axis=-1)
    stands = ((corners[..., 1] < STANDS_HEIGHT) & (speed < STANDS_SPEED)).any(2)
    after = np.minimum(np.arange(len(qvel)) + 2, len(qvel) - 1)
    before = np.maximum(np.arange(len(qvel)) - 2, 0)
    lift = (qvel[after, 1] - qvel[before, 1]) * RATE / np.maximum(after - before, 1)
    carried = (lift > (CARRIED - 1) * 9.81) & ~stands.any(1)
    stands[np.flatnonzero(carried), corners[carried][..., 1].min(2).argmin(1)] = True
    return stands


def one(character, root, rotation, angles, parts):
    """The arrays of one clip."""
    root = root.copy()
    rotation = rotation / np.linalg.norm(rotation, axis=-1, keepdims=True)
    angles = np.clip(angles, *character.ranges.T)
    qpos = np.concatenate([root, rotation[:, [3, 0, 1, 2]], angles], 1)
    qvel = velocities(qpos)
    offsets = np.broadcast_to(character.offsets, (len(root), LINKS, 3))
    frames = forward(character, offsets, qpos, qvel)
    corners = sole_corners(character, frames)
    lift = -np.percentile(corners[..., 1].min((1, 2)), SOLE_DEPTH_QUANTILE)
    for lifted in (qpos, frames.position.reshape(len(root), -1)):
        lifted[:, 1] += lift
    frames.position[:, 1:, 1] += lift
    corners[..., 1] += lift
    parts = parts.copy()
    parts[..., 1] += lift
    stands = standing(frames, corners, qvel)
    if len(qpos) > 4:
        balance(character, qpos, stands, velocities, corners, RATE)
        qvel = velocities(qpos)
        frames = forward(character, offsets, qpos, qvel)
        corners = sole_corners(character, frames)
    return {
        "qpos": qpos, "qvel": qvel, "links": frames.position.astype(np.float32),
        "speeds": frames.linear.astype(np.float32), "stands": stands,
        "foot_rotation": frames.rotation[:, [LEFT_FOOT, RIGHT_FOOT]].astype(np.float32),
        "foot_spin": frames.angular[:, [LEFT_FOOT, RIGHT_FOOT]].astype(np.float32),
        "parts_p": parts[..., :3], "parts_r": quat_to_matrix(parts[..., 3:]),
        "strain": float(unexplained(character, qpos, qvel, corners).mean()),
    }


