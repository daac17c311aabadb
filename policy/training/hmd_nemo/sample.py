"""From a chunk of motion to what the network sees and what it should answer."""

from dataclasses import dataclass

import torch

from posed_mocap.rotations import matrix_to_six, quat_to_matrix, yaw_matrix
from posed_mocap.skeleton import FEET, HEAD, LEFT_WRIST, RIGHT_WRIST, forward_kinematics

from .features import hide, observe
from .lanes import CONTROLLERS, HEAD_ONLY
from .visibility import in_view

WRISTS = [LEFT_WRIST, RIGHT_WRIST]
STILL = 0.2
"""A foot joint slower than this (m/s) counts as standing."""


@dataclass
class Sample:
    """Inputs and targets of T frames. The heading frame is the head sensor's."""

    features: torch.Tensor
    hidden_features: torch.Tensor
    """The features before hands were hidden: the forecaster's target."""
    visible: torch.Tensor
    yaw: torch.Tensor
    local: torch.Tensor
    """(B, T, 22, 3, 3), the pelvis in the heading frame."""
    globals: torch.Tensor
    """(B, T, 22, 3, 3) in the heading frame."""
    positions: torch.Tensor
    """(B, T, 22, 3) metres from the head joint, heading axes."""
    contact: torch.Tensor
    height: torch.Tensor
    offsets: torch.Tensor
    rate: float


def hand_visibility(scenario, in_head, lost, height):
    """(B, n, 2) bool from the scenario and where the hands are."""
    seen = in_view(in_head * (1.5 / height)[:, None, None, None]) & ~lost
    scenario = scenario[:, None, None]
    return (seen | (scenario == CONTROLLERS)) & (scenario != HEAD_ONLY)


def build(chunk):
    """A `Sample` from a `Chunk`."""
    local = quat_to_matrix(chunk.quats)
    world, position = forward_kinematics(local, chunk.offsets[:, None])
    position = position + chunk.root.unsqueeze(2)
    turn = quat_to_matrix(chunk.sensor_turn)[:, None]
    head_r, head_p = world[:, :, HEAD] @ turn[:, :, 0], position[:, :, HEAD]
    hand_r, hand_p = world[:, :, WRISTS] @ turn[:, :, 1:], position[:, :, WRISTS]
    features, yaw = observe(head_r, head_p, hand_r, hand_p, chunk.height, chunk.rate)
    in_head = (head_r.mT.unsqueeze(2) @ (hand_p - head_p.unsqueeze(2)).unsqueeze(-1)).squeeze(-1)
    seen = hand_visibility(chunk.scenario, in_head, chunk.lost, chunk.height)
    visible, before = seen[:, 1:], seen[:, :-1]
    to_heading = yaw_matrix(yaw).mT.unsqueeze(2)
    globals_ = to_heading @ world[:, 1:]
    relative = (position - head_p.unsqueeze(2))[:, 1:]
    speed = (position[:, 1:, FEET] - position[:, :-1, FEET]).norm(dim=-1) * chunk.rate
    return Sample(
        features=hide(features, visible, before),
        hidden_features=features,
        visible=visible,
        yaw=yaw,
        local=torch.cat([globals_[:, :, :1], local[:, 1:, 1:]], 2),
        globals=globals_,
        positions=(to_heading @ relative.unsqueeze(-1)).squeeze(-1),
        contact=(speed < STILL).float(),
        height=chunk.height,
        offsets=chunk.offsets,
        rate=chunk.rate,
    )


def forecast_target(features):
    """(B, T, 4, 9): rotation and position of the four hand streams."""
    return features[:, :, 1:, :9]


def auxiliary_target(sample):
    """(B, T, 22, 9): joint rotations (6D) and positions from the head in head heights."""
    return torch.cat([
        matrix_to_six(sample.globals), sample.positions / sample.height[:, None, None, None],
    ], -1)
