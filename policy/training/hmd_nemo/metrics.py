"""Errors of a predicted motion, as AGRoL and AvatarPoser define them, on head-aligned joints.

Each is the mean over one sequence; tables average sequences. The first frame is dropped.
"""

import torch

from posed_mocap.rotations import geodesic, small_rotvec, yaw_matrix
from posed_mocap.skeleton import FEET, LOWER, UPPER

from .features import RATE


def sequence_metrics(local, positions, true_local, true_positions, yaw, head):
    """One sequence of n frames.

    local (n, 22, 3, 3), pelvis in the heading frame; positions (n, 22, 3) metres from the head in
    heading axes; yaw (n,); head (n, 3) the head joint in the world. Returns floats by name.
    """
    turn = yaw_matrix(yaw).unsqueeze(1)
    world = (turn @ positions.unsqueeze(-1)).squeeze(-1)[1:] + head[1:, None]
    true_world = (turn @ true_positions.unsqueeze(-1)).squeeze(-1)[1:] + head[1:, None]
    distance = (world - true_world).norm(dim=-1)
    rate = ((world[1:] - world[:-1]) - (true_world[1:] - true_world[:-1])).norm(dim=-1) * RATE
    angle = geodesic(local[1:], true_local[1:])
    # Axis-angle components differ mod 2 pi; both vectors are at most pi long.
    components = (small_rotvec(local[1:, 1:]) - small_rotvec(true_local[1:, 1:])).abs()
    components = torch.minimum(components, 2 * torch.pi - components)
    standing = (true_world[1:, FEET] - true_world[:-1, FEET]).norm(dim=-1) < 0.01
    slide = (world[1:, FEET] - world[:-1, FEET])[..., [0, 2]].norm(dim=-1) * RATE
    return {
        "mpjpe_cm": 100 * distance.mean().item(),
        "mpjve_cm_s": 100 * rate.mean().item(),
        "mpjre_component_deg": components.mean().rad2deg().item(),
        "mpjre_geodesic_deg": angle[:, 1:].mean().rad2deg().item(),
        "root_deg": angle[:, 0].mean().rad2deg().item(),
        "upper_cm": 100 * distance[:, UPPER].mean().item(),
        "lower_cm": 100 * distance[:, LOWER].mean().item(),
        "hands_cm": 100 * distance[:, [20, 21]].mean().item(),
        "jitter_km_s3": jitter(world),
        "true_jitter_km_s3": jitter(true_world),
        "foot_skate_cm_s": 100 * slide[standing].mean().item() if standing.any() else 0.0,
    }


def jitter(world):
    """Mean jerk of the joints, km/s^3."""
    jerk = world[3:] - 3 * world[2:-1] + 3 * world[1:-2] - world[:-3]
    return (jerk.norm(dim=-1).mean() * RATE**3 / 1000).item()
