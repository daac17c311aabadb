"""The five losses of HMD-NeMo (Eq. 5-10), and foot contact.

Positions are compared head-aligned, as the metrics are; L1 and vector norms take the place of
squared errors, since the metrics are mean distances.
"""

import torch
from torch.nn import functional as F

from posed_mocap.rotations import matrix_to_six, yaw_matrix
from posed_mocap.skeleton import HEAD, forward_kinematics

from .sample import Sample, auxiliary_target, forecast_target

WEIGHTS = {
    "rotation": 1.0, "root": 1.0, "velocity": 1.0, "turning": 0.05, "global": 1.0,
    "position": 12.0, "forecast": 0.2, "auxiliary": 0.5, "contact": 0.05,
}


def pose_from(local, offsets):
    """World-level rotations and head-aligned joint positions from local rotations (B, T, ...)."""
    world, position = forward_kinematics(local, offsets[:, None])
    return world, position - position[:, :, HEAD : HEAD + 1]


def last_frames(sample, count):
    """The sample's last `count` frames."""
    kept = {name: value[:, -count:] for name, value in vars(sample).items()
            if name not in ("height", "offsets", "rate")}
    return Sample(height=sample.height, offsets=sample.offsets, rate=sample.rate, **kept)


def losses(out, sample):
    """Each loss by name, unweighted, and the head-aligned joint error in metres (B, T, 22, 3).

    A model may answer for only the last frames of the sample.
    """
    sample = last_frames(sample, out["six"].shape[1])
    world, position = pose_from(out["local"], sample.offsets)
    error = position - sample.positions
    turned = (yaw_matrix(sample.yaw).unsqueeze(2) @ error.unsqueeze(-1)).squeeze(-1)
    rate_error = (turned[:, 1:] - turned[:, :-1]) * sample.rate
    six_error = out["six"] - matrix_to_six(sample.local)
    named = {
        "rotation": six_error.abs().mean(),
        "velocity": (rate_error.square().sum(-1) + 1e-6).sqrt().mean(),
        "turning": (six_error[:, 1:] - six_error[:, :-1]).abs().mean() * sample.rate,
        "global": (world - sample.globals).abs().mean(),
        "position": (error.square().sum(-1) + 1e-8).sqrt().mean(),
    }
    if "root" in out:
        root = sample.positions[:, :, 0] / sample.height[:, None, None]
        named["root"] = (out["root"] - root).abs().mean()
        named["contact"] = F.binary_cross_entropy_with_logits(out["contact"], sample.contact)
    if "auxiliary" in out:
        named["auxiliary"] = (out["auxiliary"] - auxiliary_target(sample)).abs().mean()
    if "forecast" in out:
        ahead = forecast_target(sample.hidden_features)[:, 1:]
        named["forecast"] = (out["forecast"][:, :-1] - ahead).abs().mean()
    return named, error


def total(named):
    """The weighted sum."""
    return torch.stack([WEIGHTS[name] * value for name, value in named.items()]).sum()
