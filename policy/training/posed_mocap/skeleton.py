"""The 22-joint SMPL skeleton in posed's frame, and forward kinematics on it.

World: right-handed, Y up, metres, -Z forward, floor at y = 0. With all joint rotations at the
identity the skeleton stands in a T-pose, faces -Z and has its left side at -X.
"""

import torch

JOINT_NAMES = [
    "pelvis", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2",
    "left_ankle", "right_ankle", "spine3", "left_foot", "right_foot", "neck", "left_collar",
    "right_collar", "head", "left_shoulder", "right_shoulder", "left_elbow", "right_elbow",
    "left_wrist", "right_wrist",
]
PARENTS = [-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19]
JOINTS = len(PARENTS)
PELVIS, HEAD, LEFT_WRIST, RIGHT_WRIST = 0, 15, 20, 21
FEET = [7, 8, 10, 11]
UPPER = [3, 6, 9] + list(range(12, 22))
LOWER = [0, 1, 2, 4, 5, 7, 8, 10, 11]

MIRROR = [0, 2, 1, 3, 5, 4, 6, 8, 7, 9, 11, 10, 12, 14, 13, 15, 17, 16, 19, 18, 21, 20]
"""Joint order after swapping left and right."""


def _levels():
    """Joints grouped by depth, so that one batched product serves a whole level."""
    depth = [0] * JOINTS
    for joint in range(1, JOINTS):
        depth[joint] = depth[PARENTS[joint]] + 1
    return [[j for j in range(JOINTS) if depth[j] == d] for d in range(1, max(depth) + 1)]


LEVELS = _levels()
_ORDER = [0] + [j for level in LEVELS for j in level]
_RESTORE = [_ORDER.index(j) for j in range(JOINTS)]


def forward_kinematics(rotations, offsets):
    """World rotations and joint positions with the pelvis joint at the origin.

    rotations: (..., 22, 3, 3), local, the pelvis' in the world. offsets: (..., 22, 3), metres,
    broadcast against the leading shape. Returns (..., 22, 3, 3) and (..., 22, 3).
    """
    world = {0: rotations[..., 0, :, :]}
    position = {0: torch.zeros_like(rotations[..., 0, :, 0])}
    world_parts = [rotations[..., :1, :, :]]
    position_parts = [torch.zeros_like(rotations[..., :1, :, 0])]
    for level in LEVELS:
        parent_r = torch.stack([world[PARENTS[j]] for j in level], dim=-3)
        parent_p = torch.stack([position[PARENTS[j]] for j in level], dim=-2)
        joint_r = parent_r @ rotations[..., level, :, :]
        joint_p = parent_p + (parent_r @ offsets[..., level, :].unsqueeze(-1)).squeeze(-1)
        for i, j in enumerate(level):
            world[j], position[j] = joint_r[..., i, :, :], joint_p[..., i, :]
        world_parts.append(joint_r)
        position_parts.append(joint_p)
    world_all = torch.cat(world_parts, dim=-3)[..., _RESTORE, :, :]
    position_all = torch.cat(position_parts, dim=-2)[..., _RESTORE, :]
    return world_all, position_all


def head_height(offsets):
    """T-pose head joint above the lowest toe joint, (..., 22, 3) to (...)."""
    head = offsets[..., [3, 6, 9, 12, 15], 1].sum(-1)
    toes = torch.minimum(offsets[..., [1, 4, 7, 10], 1].sum(-1),
                         offsets[..., [2, 5, 8, 11], 1].sum(-1))
    return head - toes
