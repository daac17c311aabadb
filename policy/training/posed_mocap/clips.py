"""Reads the shared mocap sets (`<set>.npz`, 22 joints) and AMASS into one in-memory form at 60 Hz.

Everything returned is in posed's frame: the sets' T-pose faces +Z, posed's faces -Z, so
positions, offsets and local rotations are turned by 180 degrees about Y.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

RATE = 60.0


@dataclass
class Clip:
    """One motion at 60 Hz in posed's frame."""

    name: str
    source: str
    split: str
    quats: np.ndarray
    """(frames, 22, 4) float32, local, x y z w, sign-continuous in time."""
    root: np.ndarray
    """(frames, 3) float32, pelvis in metres."""
    offsets: np.ndarray
    """(22, 3) float32, bone offsets in the T-pose, metres."""
    head_height: float
    """T-pose head joint above the lowest toe joint, metres."""


def decode_delta(low, high):
    """Delta-coded int16 (88, n) of one clip as unit quaternions (n, 22, 4), joint-major rows."""
    delta = ((high.astype(np.uint16) << 8) | low).view(np.int16)
    values = np.cumsum(delta.T, axis=0, dtype=np.int16).reshape(-1, 22, 4).astype(np.float32)
    norm = np.linalg.norm(values, axis=-1, keepdims=True)
    if (norm < 1.0).any():
        raise ValueError("a quaternion of length zero: the delta coding does not fit this file")
    return values / norm


def sign_continuous(quats):
    """Flips signs so that neighbouring frames lie on one hemisphere; q and -q are one rotation."""
    dots = (quats[1:] * quats[:-1]).sum(-1)
    flips = np.cumprod(np.where(dots < 0, -1.0, 1.0), axis=0)
    out = quats.copy()
    out[1:] *= flips[..., None]
    return out


def resample(quats, root, fps, rate=RATE):
    """C2 cubic splines through the source frames, read at `rate` Hz."""
    quats = sign_continuous(quats)
    count = len(root)
    if abs(fps - rate) < 0.01 or count < 4:
        return quats.astype(np.float32), root.astype(np.float32)
    source = np.arange(count) / fps
    target = np.arange(int(np.floor(source[-1] * rate + 1e-6)) + 1) / rate
    spline = CubicSpline(source, quats.reshape(count, -1))
    smooth = spline(target).reshape(-1, *quats.shape[1:])
    smooth /= np.linalg.norm(smooth, axis=-1, keepdims=True)
    return smooth.astype(np.float32), CubicSpline(source, root)(target).astype(np.float32)


def to_posed_frame(quats, root, offsets):
    """Turns a motion from a T-pose facing +Z to one facing -Z."""
    flip_q = np.array([-1, 1, -1, 1], np.float32)
    flip_p = np.array([-1, 1, -1], np.float32)
    return quats * flip_q, root * flip_p, offsets * flip_p


def load_set(path, splits):
    """Yields the clips of one `.npz` set whose split is in `splits`."""
    source = path.stem
    with np.load(path, allow_pickle=False) as data:
        start, fps = data["start"], float(data["fps"])
        low, high, root = data["dquat_lo"], data["dquat_hi"], data["root"]
        offsets_all, names, heights = data["offsets"], data["names"], data["head_height"]
        for i, split in enumerate(data["split"]):
            if str(split) not in splits:
                continue
            a, b = int(start[i]), int(start[i + 1])
            quats = decode_delta(low[:, a:b], high[:, a:b])
            quats, moved = resample(quats, root[:, a:b].T, fps)
            quats, moved, offsets = to_posed_frame(quats, moved, offsets_all[i])
            yield Clip(
                name=str(names[i]), source=source, split=str(split),
                quats=quats, root=moved, offsets=offsets,
                head_height=float(heights[i]),
            )
