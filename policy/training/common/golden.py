"""A made-up motion for golden vectors, and how their numbers are written."""

import math

import numpy as np
import torch

from posed_mocap.clips import RATE
from posed_mocap.rotations import rotvec_to_quat
from posed_mocap.skeleton import JOINTS

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


def rounded(values, digits=6):
    return [float(f"{v:.{digits}g}") for v in np.asarray(values, np.float64).reshape(-1)]
