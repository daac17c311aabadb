"""What the network sees: five 6-DoF streams with velocities, free of heading and position.

Lengths are in head heights (the T-pose head joint above the lowest toe joint), so the wearer's
size drops out; angular velocities in rad/s; the heading frame stands on the floor below the head
joint and is turned with the head's yaw. FEATURES.md is the exact layout.
"""

import torch

from posed_mocap.rotations import matrix_to_six, small_rotvec, yaw_matrix, yaw_of

STREAMS = 5
STREAM_SIZE = 15
RATE = 60.0


def observe(head_r, head_p, hand_r, hand_p, height, rate=RATE):
    """Features of frames 1.. from the sensors' frames 0...

    head_r (B, T+1, 3, 3), head_p (B, T+1, 3), hand_r (B, T+1, 2, 3, 3), hand_p (B, T+1, 2, 3):
    joint poses in the world, left hand first; height (B,), metres. Returns the features
    (B, T, 5, 15) and the heading yaw (B, T) in radians.
    """
    scale = 1.0 / height[:, None, None]
    yaw = yaw_of(head_r[:, 1:])
    to_heading = yaw_matrix(yaw).mT

    def velocities(rotation, position):
        spin = small_rotvec(rotation[:, 1:] @ rotation[:, :-1].mT) * rate
        return spin, (position[:, 1:] - position[:, :-1]) * rate

    def turned(vector):
        return (to_heading @ vector.unsqueeze(-1)).squeeze(-1)

    origin = head_p[:, 1:] * torch.tensor([1.0, 0.0, 1.0], device=head_p.device)
    streams = []
    for rotation, position in [(head_r, head_p)] + [
        (hand_r[:, :, i], hand_p[:, :, i]) for i in range(2)
    ]:
        spin, speed = velocities(rotation, position)
        streams.append(torch.cat([
            matrix_to_six(to_heading @ rotation[:, 1:]),
            turned(position[:, 1:] - origin) * scale,
            turned(spin),
            turned(speed) * scale,
        ], -1))
    for i in range(2):
        rotation = head_r.mT @ hand_r[:, :, i]
        offset = hand_p[:, :, i] - head_p
        position = (head_r.mT @ offset.unsqueeze(-1)).squeeze(-1)
        spin, speed = velocities(rotation, position)
        streams.append(torch.cat([
            matrix_to_six(rotation[:, 1:]), position[:, 1:] * scale, spin, speed * scale,
        ], -1))
    return torch.stack(streams, 2), yaw


def hide(features, visible, visible_before):
    """Zeroes the hands that are not seen, and the velocities of hands seen for the first frame.

    visible (B, T, 2) bool; visible_before the same, one frame earlier.
    """
    seen = visible[..., [0, 1, 0, 1]].unsqueeze(-1)
    moving = (visible & visible_before)[..., [0, 1, 0, 1]].unsqueeze(-1)
    hands = features[:, :, 1:]
    hands = torch.cat([hands[..., :9] * seen, hands[..., 9:] * moving], -1)
    return torch.cat([features[:, :, :1], hands], 2)
