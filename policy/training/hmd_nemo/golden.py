"""Golden vectors: a made-up motion through features and network, for other runtimes to replay.

The motion is procedural (sines on a made-up skeleton), so no recorded data is in the file. The
right hand is hidden for a while, then both, then both return.
"""

import json
import math

import numpy as np
import torch

from posed_mocap.amass import AVERAGE_OFFSETS
from posed_mocap.rotations import quat_to_matrix, rotvec_to_quat
from posed_mocap.skeleton import HEAD, JOINTS, LEFT_WRIST, RIGHT_WRIST, forward_kinematics

from .features import RATE, hide, observe
from .lanes import head_height
from .step import Step, example_inputs

FRAMES = 120


def procedural_motion(frames=FRAMES):
    """Walks in a circle, swings the arms and nods. Local quaternions (n, 22, 4), root (n, 3)."""
    t = torch.arange(frames) / RATE
    turns = torch.zeros(frames, JOINTS, 3)
    phase = 2 * math.pi * 0.9 * t
    heading = 0.6 * t + 0.4
    turns[:, 1, 0], turns[:, 2, 0] = 0.4 * phase.sin(), -0.4 * phase.sin()
    turns[:, 4, 0] = -0.5 * (1 - (phase + 0.6).cos())
    turns[:, 5, 0] = -0.5 * (1 + (phase + 0.6).cos())
    turns[:, 6, 0] = -0.08 + 0.03 * (2 * phase).cos()
    turns[:, 15, 0], turns[:, 15, 2] = -0.3 * (1.3 * t).sin(), 0.15 * (2.1 * t).sin()
    turns[:, 15, 1] = 0.5 * (0.8 * t).sin()
    turns[:, 16, 2], turns[:, 17, 2] = 1.1 + 0.2 * phase.sin(), -1.1 + 0.2 * phase.cos()
    turns[:, 18, 1], turns[:, 19, 1] = -0.6 + 0.5 * phase.cos(), 0.9 + 0.5 * phase.sin()
    turns[:, 20, 0], turns[:, 21, 2] = 0.3 * (3 * t).sin(), 0.3 * (2 * t).cos()
    turns[:, 0, 1] = heading
    radius = 1.2
    root = torch.stack([
        radius * (heading.cos() - 1), 0.93 + 0.02 * (2 * phase).cos(), -radius * heading.sin(),
    ], -1)
    return rotvec_to_quat(turns), root


def hand_flags(frames=FRAMES):
    """Visibility (n, 2): right hidden from 30, both from 55, left back at 80, right at 90."""
    visible = torch.ones(frames, 2, dtype=torch.bool)
    visible[55:80, 0] = False
    visible[30:90, 1] = False
    return visible


def sensors(quats, root, offsets):
    """World poses of head, left and right hand: rotations (n, 3, 3, 3), positions (n, 3, 3)."""
    world, position = forward_kinematics(quat_to_matrix(quats), offsets)
    joints = [HEAD, LEFT_WRIST, RIGHT_WRIST]
    return world[:, joints], position[:, joints] + root[:, None]


def motion_features(frames=FRAMES):
    """Sensor poses, flags, features (n, 5, 15) and yaw (n,) of the procedural motion."""
    offsets = torch.from_numpy(AVERAGE_OFFSETS)
    height = head_height(offsets)
    rotation, position = sensors(*procedural_motion(frames), offsets)
    rotation = torch.cat([rotation[:1], rotation])[None]
    position = torch.cat([position[:1], position])[None]
    visible = hand_flags(frames)[None]
    features, yaw = observe(rotation[:, :, 0], position[:, :, 0], rotation[:, :, 1:],
                            position[:, :, 1:], height[None])
    before = torch.cat([visible[:, :1], visible[:, :-1]], 1)
    features = hide(features, visible, before)
    return rotation[0, 1:], position[0, 1:], visible[0], features[0], yaw[0], float(height)


def matrix_to_quat(matrix):
    """(n, 3, 3) to (n, 4), w >= 0, through the largest eigenvector: exact for any angle."""
    m = matrix.double().numpy()
    out = []
    for r in m.reshape(-1, 3, 3):
        k = np.array([
            [r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[2, 1] - r[1, 2]],
            [r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], r[1, 2] + r[2, 1], r[0, 2] - r[2, 0]],
            [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r[0, 0] + r[1, 1] + r[2, 2]],
        ]) / 3
        q = np.linalg.eigh(k)[1][:, -1]
        out.append(q if q[3] >= 0 else -q)
    return np.array(out).reshape(*m.shape[:-2], 4)


@torch.no_grad()
def play(model, features, visible):
    """Steps the model frame by frame from a reset; rotation, root and contact of each frame."""
    step = Step(model).eval()
    _, _, _, *state = example_inputs(model)
    rows = []
    for i in range(len(features)):
        reset = torch.tensor([1.0 if i == 0 else 0.0])
        flags = visible[i : i + 1].float()
        rotation, root, contact, *state = step(features[i : i + 1], flags, reset, *state)
        rows.append((rotation[0], root[0], contact[0]))
    return [torch.stack(part) for part in zip(*rows)]


def rounded(values, digits=6):
    return [float(f"{v:.{digits}g}") for v in np.asarray(values, np.float64).reshape(-1)]


def write(model, path):
    """One JSON with flat arrays; the shapes are in FEATURES.md."""
    rotation, position, visible, features, yaw, height = motion_features()
    local, root, contact = play(model, features, visible)
    path.write_text(json.dumps({
        "rate": RATE, "frames": len(features), "head_height": height,
        "sensor_position": rounded(position), "sensor_rotation": rounded(matrix_to_quat(rotation), 7),
        "visible": visible.int().flatten().tolist(), "yaw": rounded(yaw),
        "features": rounded(features, 5), "rotation": rounded(matrix_to_quat(local), 5),
        "root": rounded(root, 5), "contact": rounded(contact, 4),
    }, separators=(",", ":")))
