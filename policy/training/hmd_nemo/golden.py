"""Golden vectors: a made-up motion through features and network, for other runtimes to replay.

The motion is procedural (sines on a made-up skeleton), so no recorded data is in the file. The
right hand is hidden for a while, then both, then both return.
"""

import json

import torch

from common.golden import FRAMES, matrix_to_quat, procedural_motion, rounded
from posed_mocap.amass import AVERAGE_OFFSETS
from posed_mocap.rotations import quat_to_matrix
from posed_mocap.skeleton import HEAD, LEFT_WRIST, RIGHT_WRIST, forward_kinematics, head_height

from .features import RATE, hide, observe
from .step import Step, example_inputs


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
