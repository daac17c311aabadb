"""Which hands the headset sees: a hand-tracking frustum like HoloLens 2's, and random loss."""

from dataclasses import dataclass

import torch


@dataclass(frozen=True)
class Frustum:
    """Hand-tracking camera on the headset. Lengths in metres for a 1.5 m head height."""

    up: float = 0.08
    forward: float = 0.09
    pitch_down: float = 0.45
    half_width: float = 1.00
    half_height: float = 0.95
    near: float = 0.10
    far: float = 1.10


def in_view(in_head, frustum=Frustum()):
    """Whether hands at `in_head` (..., 3), metres in the head joint's frame, are inside."""
    rel = in_head - torch.tensor([0.0, frustum.up, -frustum.forward], device=in_head.device)
    c, s = torch.tensor(frustum.pitch_down).cos(), torch.tensor(frustum.pitch_down).sin()
    depth = -rel[..., 2] * c - rel[..., 1] * s
    height = rel[..., 1] * c - rel[..., 2] * s
    wide = torch.atan2(rel[..., 0].abs(), depth) < frustum.half_width
    tall = torch.atan2(height.abs(), depth) < frustum.half_height
    distance = rel.norm(dim=-1)
    return (depth > 0) & wide & tall & (distance > frustum.near) & (distance < frustum.far)


def random_loss(start, frames, generator, begin=1 / 240, end=1 / 20):
    """Two-state Markov loss (B, frames, 2): `start` (B, 2) says which hands begin lost."""
    draws = torch.rand(start.shape[0], frames, 2, generator=generator)
    lost, out = start, []
    for t in range(frames):
        lost = torch.where(lost, draws[:, t] > end, draws[:, t] < begin)
        out.append(lost)
    return torch.stack(out, 1)
