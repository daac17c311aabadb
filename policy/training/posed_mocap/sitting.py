"""A made-up set of people who sit: recorded sets hardly sit, and never for long.

    python -m posed_mocap.sitting OUT/sitting.npz --clips 120

Each stands, sits down on something, stays for up to 40 seconds, moves as seated people do, and gets
up again; some begin seated. Seats, legs, trunks and arms differ from one to the next. No recorded
data is in it: the file may be trained on and passed on.
"""

import argparse
from pathlib import Path

import numpy as np
import torch

from .amass import AVERAGE_OFFSETS
from .clips import RATE, Clip, sign_continuous
from .convert import write
from .rotations import quat_multiply, quat_to_matrix, rotvec_to_quat
from .skeleton import JOINTS, forward_kinematics

SECONDS = 90
LEFT_ANKLE, RIGHT_ANKLE = 7, 8
TOES = [10, 11]
TOE_HEIGHT = 0.025


def ease(t):
    """From 0 to 1 at rest at both ends (minimum jerk)."""
    t = np.clip(t, 0.0, 1.0)
    return t**3 * (10 + t * (6 * t - 15))


class Curve:
    """A number that moves from one goal to the next."""

    def __init__(self, first):
        self.keys = [(0.0, 0.0, first)]

    def go(self, at, seconds, goal):
        """Reaches `goal` within `seconds` from `at` on."""
        self.keys.append((at, seconds, goal))

    def at(self, time):
        value = np.full_like(time, self.keys[0][2])
        for begin, seconds, goal in self.keys[1:]:
            value += (goal - value) * ease((time - begin) / seconds)
        return value


def wander(random, time, size):
    """Slow idle movement of about `size`."""
    rates, phases = random.uniform(0.1, 1.2, 3), random.uniform(0, 6.3, 3)
    return size * sum(np.sin(r * time + p) for r, p in zip(rates, phases)) / 2


def timetable(random):
    """(sits down at, takes s, gets up at, takes s) until the clip is over."""
    out, now = [], random.uniform(1.0, 4.0)
    if random.random() < 0.3:
        now = -3.0
    while now < SECONDS - 4:
        down, up = random.uniform(1.0, 2.5), random.uniform(1.0, 2.2)
        rise = now + down + random.uniform(4, 40)
        out.append((now, down, rise, up))
        now = rise + up + random.uniform(0.5, 4.0)
    return out


def sitter(random, name):
    """One clip."""
    time = np.arange(SECONDS * int(RATE)) / RATE
    sat, lean = Curve(0.0), Curve(random.uniform(-0.05, 0.08))
    thigh, shank, open_ = (Curve(v) for v in (0.0, 0.0, random.uniform(0.0, 0.08)))
    tilt, curl = Curve(0.0), Curve(0.0)
    hang = [Curve(1.4 + random.uniform(-0.1, 0.1)) for _ in "lr"]
    reach, bend, twist = ([Curve(random.uniform(-0.1, 0.2)) for _ in "lr"] for _ in range(3))
    look = [Curve(0.0) for _ in "yp"]
    for down, takes, up, rises in timetable(random):
        seat = random.uniform(1.05, 1.65)
        feet = random.uniform(-0.35, 0.4)
        for curve, goal in ((sat, 1.0), (thigh, seat), (shank, feet),
                            (open_, random.uniform(0.0, 0.35)), (tilt, random.uniform(-0.25, 0.4)),
                            (curl, random.uniform(-0.1, 0.3))):
            curve.go(down, takes, goal)
            curve.go(up, rises, 0.0)
        bow = random.uniform(0.3, 0.9)
        lean.go(down - 0.1, 0.6 * takes, bow)
        lean.go(down + 0.55 * takes, 0.7 * takes, random.uniform(-0.25, 0.3))
        lean.go(up - 0.2, 0.6 * rises, bow)
        lean.go(up + 0.5 * rises, 0.7 * rises, random.uniform(-0.05, 0.08))
        at = down
        while at < min(up, SECONDS):
            for side in (0, 1):
                hang[side].go(at, 1.0, random.uniform(0.9, 1.5))
                reach[side].go(at, 1.0, random.uniform(0.0, 1.1))
                bend[side].go(at, 1.0, random.uniform(0.1, 2.0))
                twist[side].go(at, 1.0, random.uniform(-0.4, 0.6))
            look[0].go(at, 0.8, random.uniform(-0.7, 0.7))
            look[1].go(at, 0.8, random.uniform(-0.4, 0.3))
            at += random.uniform(1.5, 12)
        for side in (0, 1):
            hang[side].go(up, rises, random.uniform(1.25, 1.5))
            reach[side].go(up, rises, random.uniform(-0.1, 0.2))
            bend[side].go(up, rises, random.uniform(0.0, 0.4))
    t = lambda curve: curve.at(time)
    idle = t(sat) * random.uniform(0.3, 1.0)
    turns = np.zeros((len(time), JOINTS, 3))
    pitch = t(tilt) - 0.6 * t(lean) + idle * wander(random, time, 0.04)
    turns[:, 6, 0] = -0.2 * t(lean) - 0.5 * t(curl) + idle * wander(random, time, 0.03)
    turns[:, 9, 0] = -0.2 * t(lean) - 0.5 * t(curl) - 0.5 * t(tilt)
    turns[:, 6, 1] = idle * wander(random, time, 0.06)
    turns[:, 12, 0] = 0.4 * t(lean) + 0.5 * t(curl)
    turns[:, 15, 1], turns[:, 15, 0] = t(look[0]), t(look[1]) + 0.2 * t(lean)
    for side, (shoulder, elbow, sign) in enumerate(((16, 18, 1), (17, 19, -1))):
        turns[:, elbow, 1] = -sign * np.maximum(t(bend[side]), 0)
        turns[:, elbow, 0] = t(twist[side])
    quats = rotvec_to_quat(torch.from_numpy(turns).float())
    about = lambda axis, angle: rotvec_to_quat(torch.from_numpy(
        np.stack([angle if i == axis else 0 * angle for i in range(3)], -1)).float())
    facing = about(1, np.full_like(time, random.uniform(-3.1, 3.1)))
    pelvis = quat_multiply(quat_multiply(
        about(1, idle * wander(random, time, 0.05)), about(0, pitch)),
        about(2, idle * wander(random, time, 0.03)))
    quats[:, 0] = quat_multiply(facing, pelvis)
    back = pelvis * torch.tensor([-1.0, -1, -1, 1])
    for hip, knee, ankle, sign in ((1, 4, 7, -1), (2, 5, 8, 1)):
        swing = wander(random, time, 0.04) * idle
        apart = sign * (t(open_) + swing)
        upper = quat_multiply(about(1, -apart), about(0, t(thigh)))
        quats[:, hip] = quat_multiply(back, upper)
        quats[:, knee] = about(0, -t(thigh) + t(shank))
        quats[:, ankle] = about(0, -t(shank))
    for side, (shoulder, sign) in enumerate(((16, 1), (17, -1))):
        quats[:, shoulder] = quat_multiply(
            about(0, t(reach[side]) + idle * wander(random, time, 0.05)),
            about(2, sign * t(hang[side])))
    scale = random.uniform(0.86, 1.14)
    offsets = AVERAGE_OFFSETS * scale * (1 + 0.05 * random.standard_normal((JOINTS, 1)))
    left, right = np.array([1, 4, 7, 10, 13, 16, 18, 20]), np.array([2, 5, 8, 11, 14, 17, 19, 21])
    offsets[right] = offsets[left] * [-1, 1, 1]
    offsets = offsets.astype(np.float32)
    places = forward_kinematics(quat_to_matrix(quats), torch.from_numpy(offsets))[1].numpy()
    # The feet stay where they are.
    feet = (places[:, LEFT_ANKLE] + places[:, RIGHT_ANKLE]) / 2
    root = (feet[:1] - feet).astype(np.float32)
    root[:, 1] += TOE_HEIGHT - (places[0, TOES, 1].min() + root[0, 1])
    rest = torch.eye(3).expand(1, JOINTS, 3, 3)
    standing = forward_kinematics(rest, torch.from_numpy(offsets)[None])[1][0].numpy()
    return Clip(name=name, source="sitting", split="train",
                quats=sign_continuous(quats.numpy()), root=root, offsets=offsets,
                head_height=float(standing[15, 1] - standing[TOES, 1].min()))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--clips", type=int, default=120)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    random = np.random.default_rng(args.seed)
    write([sitter(random, f"sitting-{i}") for i in range(args.clips)], args.out)


if __name__ == "__main__":
    main()
