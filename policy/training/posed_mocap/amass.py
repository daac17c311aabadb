"""AMASS sequences (SMPL+H `.npz`) as clips, for whoever has the data; it is not shipped.

Takes the first 22 joints' axis-angle poses. The body shape is ignored, as AvatarPoser and its
successors do: bone offsets are given, by default an average adult's, and the motion is set on the
floor for them.
"""

from pathlib import Path

import numpy as np
import torch

from .clips import Clip, resample
from .rotations import quat_multiply, quat_to_matrix, rotvec_to_quat
from .skeleton import JOINTS, forward_kinematics

AVERAGE_OFFSETS = np.array([
    [0, 0, 0], [-.07, -.08, 0], [.07, -.08, 0], [0, .11, .01], [-.02, -.38, 0], [.02, -.38, 0],
    [0, .13, 0], [0, -.40, .02], [0, -.40, .02], [0, .06, 0], [0, -.06, -.12], [0, -.06, -.12],
    [0, .21, .02], [-.08, .12, .01], [.08, .12, .01], [0, .09, -.05], [-.09, .03, .01],
    [.09, .03, .01], [-.26, 0, .02], [.26, 0, .02], [-.25, 0, 0], [.25, 0, 0],
], np.float32)
"""Rounded adult bone offsets in posed's frame, metres."""


PELVIS_REST = np.array([-0.002, -0.223, 0.028])
"""SMPL+H's pelvis joint in its own rest frame, which AMASS adds to `trans` unrotated, metres."""

TOE_HEIGHT = 0.03
"""Height of a standing toe joint above the floor, metres."""


def turn_upright(poses, trans):
    """AMASS is Z-up with the body's own frame Y-up facing +Z: gives Y-up quaternions and root.

    poses (n, 22, 3) rotation vectors, trans (n, 3). The world turns by -90 degrees about X; the
    body's own axes already are Y-up, so only the pelvis rotation changes.
    """
    quats = rotvec_to_quat(torch.from_numpy(poses).float())
    half = torch.tensor(0.5).sqrt()
    world = torch.stack([-half, torch.zeros(()), torch.zeros(()), half])
    quats[:, 0] = quat_multiply(world.expand(len(quats), 4), quats[:, 0])
    root = np.stack([trans[:, 0], trans[:, 2], -trans[:, 1]], 1)
    return quats.numpy(), root.astype(np.float32)


def load_file(path, offsets=AVERAGE_OFFSETS):
    """One sequence as a clip, or None for a file without motion (`shape.npz`)."""
    with np.load(path, allow_pickle=False) as data:
        if "poses" not in data.files:
            return None
        rate_name = next((n for n in ("mocap_framerate", "mocap_frame_rate") if n in data.files), None)
        if rate_name is None:
            raise ValueError(f"{path} has poses and no frame rate: is it an AMASS file?")
        poses, trans = data["poses"], data["trans"]
        rate = float(data[rate_name])
    if rate > 100:
        stride = max(1, round(rate / 60))
        poses, trans, rate = poses[::stride], trans[::stride], rate / stride
    quats, root = turn_upright(poses[:, : 3 * JOINTS].reshape(-1, JOINTS, 3), trans + PELVIS_REST)
    quats, root = resample(quats, root, rate)
    # SMPL's T-pose faces +Z with the left side at +X, like the shared sets.
    quats = quats * np.array([-1, 1, -1, 1], np.float32)
    root = root * np.array([-1, 1, -1], np.float32)
    toes = offsets[[1, 4, 7, 10], 1].sum()
    head = float(offsets[[3, 6, 9, 12, 15], 1].sum() - toes)
    root = on_the_floor(quats, root, offsets)
    return Clip(Path(path).stem, "amass", "train", quats, root, offsets, head)


def on_the_floor(quats, root, offsets):
    """Shifts a motion vertically, since the given body's legs differ from the recorded one's."""
    local = quat_to_matrix(torch.from_numpy(quats))
    _, position = forward_kinematics(local, torch.from_numpy(offsets))
    toes = position[:, [10, 11], 1].numpy().min(1) + root[:, 1]
    out = root.copy()
    out[:, 1] += TOE_HEIGHT - np.percentile(toes, 5)
    return out


def load_folder(folder):
    """Every AMASS file below `folder`, in name order."""
    for path in sorted(Path(folder).rglob("*.npz")):
        clip = load_file(path)
        if clip is not None:
            yield clip
