"""Rotation conversions on tensors. Quaternions are x, y, z, w and unit; matrices act on columns."""

import torch


def quat_to_matrix(q):
    """(..., 4) unit quaternions to (..., 3, 3)."""
    x, y, z, w = q.unbind(-1)
    rows = [
        1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
        2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
        2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y),
    ]
    return torch.stack(rows, -1).unflatten(-1, (3, 3))


def quat_multiply(a, b):
    """Product a b: b acts first."""
    ax, ay, az, aw = a.unbind(-1)
    bx, by, bz, bw = b.unbind(-1)
    return torch.stack([
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    ], -1)


def rotvec_to_quat(v):
    """(..., 3) rotation vectors in radians to quaternions."""
    angle = v.norm(dim=-1, keepdim=True)
    half = 0.5 * angle
    scale = torch.where(angle < 1e-6, torch.full_like(angle, 0.5), half.sin() / angle.clamp_min(1e-9))
    return torch.cat([v * scale, half.cos()], -1)


def matrix_to_six(m):
    """The first column, then the second column of (..., 3, 3), as (..., 6) (Zhou et al. 2019)."""
    return torch.cat([m[..., :, 0], m[..., :, 1]], -1)


def six_to_matrix(six):
    """Gram-Schmidt of two columns (..., 6) to a rotation (..., 3, 3)."""
    a, b = six[..., :3], six[..., 3:]
    x = a / a.norm(dim=-1, keepdim=True).clamp_min(1e-6)
    b = b - (x * b).sum(-1, keepdim=True) * x
    y = b / b.norm(dim=-1, keepdim=True).clamp_min(1e-6)
    z = torch.stack([
        x[..., 1] * y[..., 2] - x[..., 2] * y[..., 1],
        x[..., 2] * y[..., 0] - x[..., 0] * y[..., 2],
        x[..., 0] * y[..., 1] - x[..., 1] * y[..., 0],
    ], -1)
    return torch.stack([x, y, z], -1)


def small_rotvec(delta):
    """Rotation vector of (..., 3, 3) matrices, for angles below about 170 degrees."""
    skew = 0.5 * torch.stack([
        delta[..., 2, 1] - delta[..., 1, 2],
        delta[..., 0, 2] - delta[..., 2, 0],
        delta[..., 1, 0] - delta[..., 0, 1],
    ], -1)
    sine = skew.norm(dim=-1, keepdim=True)
    cosine = 0.5 * (delta.diagonal(dim1=-2, dim2=-1).sum(-1, keepdim=True) - 1)
    angle = torch.atan2(sine, cosine)
    return skew * torch.where(sine < 1e-5, torch.ones_like(sine), angle / sine.clamp_min(1e-9))


def geodesic(a, b):
    """Angle in radians between rotations (..., 3, 3), accurate near zero."""
    chord = (a - b).square().sum((-1, -2)).clamp_min(0).sqrt() / 8**0.5
    return 2 * torch.asin(chord.clamp(max=1.0))


def yaw_of(matrix):
    """Heading: the twist about +Y of (..., 3, 3) rotations, in radians.

    The swing-twist split stays smooth when the wearer looks straight down, where the forward
    axis has no heading. It equals atan2(r02 - r20, r00 + r22).
    """
    return torch.atan2(matrix[..., 0, 2] - matrix[..., 2, 0], matrix[..., 0, 0] + matrix[..., 2, 2])


def yaw_matrix(yaw):
    """Rotation about +Y by (...) radians."""
    c, s, zero, one = yaw.cos(), yaw.sin(), torch.zeros_like(yaw), torch.ones_like(yaw)
    return torch.stack([c, zero, s, zero, one, zero, -s, zero, c], -1).unflatten(-1, (3, 3))
