"""Golden vectors: a made-up motion through sensors, features and networks, for other runtimes.

The motion is procedural, so no recorded data is in the file. The left forearm's
sensor is lost for a while.
"""

import json

import torch

from common.golden import FRAMES, matrix_to_quat, procedural_motion, rounded
from posed_mocap.amass import AVERAGE_OFFSETS
from posed_mocap.rotations import quat_to_matrix
from posed_mocap.skeleton import forward_kinematics, head_height

from .lanes import LEAVES
from .model import VELOCITY_SIZE
from .motion import RATE
from .sensors import COUNT, JOINTS_OF, features, usual_place
from .step import Step, example_inputs

LOST = range(40, 60)


def motion_features(frames=FRAMES):
    """Sensors' rotations (n, 6, 3, 3), accelerations (n, 6, 3), what is seen (n, 6), features
    (n, 72), the first pose's leaves and velocities, the head height."""
    offsets = torch.from_numpy(AVERAGE_OFFSETS)
    quats, root = procedural_motion(frames + 2)
    turns, places = forward_kinematics(quat_to_matrix(quats), offsets)
    world = places + root[:, None]
    arm = usual_place(offsets[None])[0]
    path = world[:, JOINTS_OF] + (turns[:, JOINTS_OF] @ arm.unsqueeze(-1)).squeeze(-1)
    acceleration = (path[2:] - 2 * path[1:-1] + path[:-2]) * RATE**2
    told = turns[1:-1, JOINTS_OF]
    seen = torch.ones(frames, COUNT, dtype=torch.bool)
    seen[LOST.start : LOST.stop, 0] = False
    height = head_height(offsets)
    x = features(told[None], acceleration[None], height[None], seen[None])[0]
    into_root = turns[0, 0].mT
    leaves = (into_root @ places[0, LEAVES].unsqueeze(-1)).squeeze(-1) / height
    # Somebody at rest, as runtimes begin.
    velocities = torch.zeros(VELOCITY_SIZE)
    return told, acceleration, seen, x, leaves.flatten(), velocities, float(height)


@torch.no_grad()
def play(model, x, leaves, velocities):
    """Steps the model frame by frame from a reset: rotations, velocities, contact, joints."""
    step = Step(model).eval()
    state, rows = example_inputs(model)[-1], []
    for i in range(len(x)):
        reset = torch.tensor([1.0 if i == 0 else 0.0])
        *answer, state = step(x[i : i + 1], reset, leaves[None], velocities[None], state)
        rows.append([part[0] for part in answer])
    return [torch.stack(part) for part in zip(*rows)]


def write(model, path):
    """One JSON with flat arrays; the shapes are in FEATURES.md."""
    told, acceleration, seen, x, leaves, velocities, height = motion_features()
    rotations, speeds, contact, joints = play(model, x, leaves, velocities)
    path.write_text(json.dumps({
        "rate": RATE, "frames": len(x), "head_height": height,
        "sensor_rotation": rounded(matrix_to_quat(told), 7),
        "sensor_acceleration": rounded(acceleration),
        "seen": seen.int().flatten().tolist(), "features": rounded(x, 5),
        "first_leaves": rounded(leaves), "first_velocities": rounded(velocities),
        "rotations": rounded(matrix_to_quat(rotations), 5), "velocities": rounded(speeds, 5),
        "contact": rounded(contact, 4), "joints": rounded(joints, 5),
    }, separators=(",", ":")))
