"""Six inertial sensors on a motion, and the features that the networks see.

Synthesis after TransPose (Yi et al. 2021) and PIP: orientation of the bone, acceleration as a
second difference over some frames of the sensor's path. Here each wearer also straps the sensors
on at another place and a little askew, and they have bias, noise and headings that drift.
"""

import torch

from posed_mocap.rotations import quat_to_matrix, yaw_matrix, yaw_of

SENSORS = ["left_wrist", "right_wrist", "left_knee", "right_knee", "head", "waist"]
JOINTS_OF = [18, 19, 4, 5, 15, 0]
"""The joint whose bone carries each sensor, in `SENSORS` order: PIP's."""
ENDS = [20, 21, 7, 8, -1, -1]
"""The joint at the far end of that bone."""
COUNT = len(SENSORS)
PELVIS = 5
INPUTS = 72
ACCELERATION = 20.0
"""Accelerations are divided by this and by the head height."""
ALONG = torch.tensor([0.8, 0.8, 0.2, 0.2, 0.0, 0.0])
"""Usual place of each sensor along its bone, and beside it in metres (posed's frame)."""
BESIDE = torch.tensor([[0.0, 0.03, 0.0], [0.0, 0.03, 0.0], [0.0, 0.0, -0.05], [0.0, 0.0, -0.05],
                       [0.0, 0.1, 0.05], [0.0, 0.05, 0.1]])


def usual_place(offsets):
    """(B, 22, 3) bone offsets to the sensors' usual places on their bones (B, 6, 3)."""
    ends = torch.stack([offsets[:, max(e, 0)] for e in ENDS], 1)
    return ends * ALONG[None, :, None] + BESIDE


def features(turns, accelerations, height, seen=None):
    """What the networks see, (B, T, 72).

    turns (B, T, 6, 3, 3) bone rotations in the world as the sensors tell them, accelerations
    (B, T, 6, 3) in the world without gravity, height (B,) metres, seen (B, T, 6) bool. In the
    pelvis's frame: accelerations of the five others less the pelvis's, the pelvis's own; rotations
    of the five others, row by row; the pelvis's rotation without its heading. A sensor that is
    not seen has zeros.
    """
    root = turns[:, :, PELVIS]
    own = accelerations[:, :, PELVIS:]
    relative = torch.cat([accelerations[:, :, :PELVIS] - own, own], 2)
    local = (root.mT.unsqueeze(2) @ relative.unsqueeze(-1)).squeeze(-1)
    local = local / (ACCELERATION * height[:, None, None, None])
    tilt = yaw_matrix(yaw_of(root)).mT @ root
    rotations = torch.cat([root.mT.unsqueeze(2) @ turns[:, :, :PELVIS], tilt.unsqueeze(2)], 2)
    rotations = rotations.flatten(-2)
    if seen is not None:
        local = local * seen.unsqueeze(-1)
        rotations = rotations * seen.unsqueeze(-1)
    return torch.cat([local.flatten(-2), rotations.flatten(-2)], -1)


def measure(turns, places, arm, spread, error):
    """Sensors on a motion.

    turns (B, T, 3, 6, 4) world quaternions of the carrying bones `spread` (B,) seconds before, at
    and after each of T times; places (B, T, 3, 6, 3) their joints in the world; arm (B, 6, 3) the
    sensor on its bone; error: `SensorError` of the lanes. Gives rotations (B, T, 6, 3, 3) and
    accelerations (B, T, 6, 3).
    """
    matrix = quat_to_matrix(turns)
    path = places + (matrix @ arm[:, None, None, :, :, None]).squeeze(-1)
    second = path[:, :, 0] - 2 * path[:, :, 1] + path[:, :, 2]
    acceleration = second / spread[:, None, None, None] ** 2
    return error.apply(matrix[:, :, 1], acceleration)


class SensorError:
    """Faults of B times six sensors over T frames."""

    def __init__(self, askew, drift, bias, noise, generator):
        """askew (B, 6, 4) fixed turn of the sensor on its bone; drift (B, T, 6) error of heading,
        radians; bias (B, 6, 3) m/s² in the sensor's frame; noise (B,) m/s²."""
        self.askew, self.drift, self.bias, self.noise = askew, drift, bias, noise
        self.generator = generator

    def apply(self, turns, acceleration):
        told = yaw_matrix(self.drift) @ turns @ quat_to_matrix(self.askew)[:, None]
        shape = acceleration.shape
        noise = torch.randn(shape, generator=self.generator) * self.noise[:, None, None, None]
        faulty = (told @ (self.bias[:, None] + noise).unsqueeze(-1)).squeeze(-1)
        # The device turns what it feels by where it believes to point.
        seen = (yaw_matrix(self.drift) @ acceleration.unsqueeze(-1)).squeeze(-1)
        return told, seen + faulty


class NoError:
    """Perfect sensors."""

    @staticmethod
    def apply(turns, acceleration):
        return turns, acceleration


def mirror_turns(quats):
    """World quaternions seen in a mirror across x = 0 (left and right not yet exchanged)."""
    return quats * torch.tensor([1.0, -1.0, -1.0, 1.0])
