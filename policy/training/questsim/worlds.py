"""Many worlds, each a character that shall follow a clip: the environment of training.

A policy step is 1/36 s in four physics steps of 1/144 s under constant torques. Episodes start
anywhere in a clip, in its pose and moving with it, and end with the clip, after `steps_max`, or
early when the character has lost the motion.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from .balance import keep_feet
from .character import (FEET, HEAD, HINGES, LINKS, PELVIS, forward, quat_to_matrix, rotate,
                        rotation_exp, rotation_log)
from .motion import sole_corners
from .observation import FUTURE, PARTS, SUBSTEPS, future_parts, observe

LOST = 0.5
"""An episode ends when pelvis or head are so far from the reference, metres."""
FALLEN = 0.55
"""It ends too when the pelvis is below this share of its height in the reference."""
LOOKAHEADS = (6, 6, 2, 0)
"""What a training draws from."""
STATE = mujoco.mjtState.mjSTATE_INTEGRATION
CARRIED = ("clip", "frame", "age", "lookahead", "hands", "feet", "mounts")
STAYS = 0.4
"""Clips in which the pelvis goes slower than this over the floor are of somebody standing, m/s."""
JOLT_TILT, JOLT_ANGLES, JOLT_FEET, JOLT_YAW = 0.04, 0.06, 0.05, 0.12
JOLT_SPEED, JOLT_RATES = 0.1, 0.5
"""Spread of a jolted start: radians, radians, metres, radians; m/s, rad/s."""
WEIGHTS = np.array([0.4, 0.1, 0.2, 0.1, 0.2])
KERNELS = np.array([40.0, 0.3, 6.0, 2.0, 0.01])
"""Reward (4), in the order angles, rates, positions, velocities, falling contact force."""


@dataclass
class Options:
    """What the worlds practise."""

    lookaheads: tuple = (6, 2, 0)
    headset_only: float = 0.3
    """Share of episodes without controllers."""
    steps_max: int = 360
    assist: float = 0.0
    """Share of the helping wrench on the pelvis."""
    lost: float = LOST
    random_start: bool = True
    jolted: float = 0.0
    """Share of episodes that begin off the reference, as a tracker's do that knows no legs."""
    misplaced: float = 0.0
    """Spread of where the devices sit on head and hands in an episode, off where they should, metres."""
    standing: float | None = None
    """Share of episodes in which the mover stays about where it is; as in the motion by default."""


def practice_arguments(parser):
    """What a training may practise, for `practice`."""
    parser.add_argument("--jolted", type=float, default=0.3,
                        help="share of episodes that begin off the reference")
    parser.add_argument("--misplaced", type=float, default=0.01,
                        help="spread of where the devices sit on head and hands, metres")
    parser.add_argument("--standing", type=float,
                        help="share of episodes of somebody who stays about where it is")


def practice(args, **more):
    """Options of a training's worlds."""
    return Options(lookaheads=LOOKAHEADS, headset_only=0.25, jolted=args.jolted,
                   misplaced=args.misplaced, standing=args.standing, **more)


class Worlds:
    """`count` worlds on `motion`."""

    def __init__(self, motion, count, seed=0, options=None):
        self.motion, self.count = motion, count
        self.options = options or Options()
        self.rng = np.random.default_rng(seed)
        # Of each character, those that no world uses at present.
        self.spare = {}
        self.data = [None] * count
        self.models = [None] * count
        self.clip = np.zeros(count, np.int64)
        self.frame = np.zeros(count, np.int64)
        self.age = np.zeros(count, np.int64)
        self.lookahead = np.zeros(count, np.int64)
        self.hands = np.ones(count, bool)
        self.mounts = np.zeros((count, PARTS, 3))
        self.offsets = np.zeros((count, LINKS, 3))
        self.stature = np.zeros(count)
        self.torque = np.ones((count, HINGES))
        self.feet = np.zeros((count, 2, 3))
        self.qpos = np.zeros((count, 40))
        self.qvel = np.zeros((count, 39))
        self.frames = None
        lengths = np.diff(motion.start)
        self.usable = np.flatnonzero(lengths > FUTURE + 4)
        self.weight = lengths[self.usable] / lengths[self.usable].sum()
        if self.options.standing is not None:
            self.weight = self.by_kind(self.weight, self.options.standing)
        self.reset(np.arange(count))

    def by_kind(self, weight, standing):
        """Clips' chances so that `standing` of all are of somebody who stays."""
        bounds = zip(self.motion.start[self.usable], self.motion.start[self.usable + 1])
        pace = [np.linalg.norm(self.motion.qvel[a:b, [0, 2]], axis=1).mean() for a, b in bounds]
        stays = np.array(pace) < STAYS
        shares = np.where(stays, standing / max(weight[stays].sum(), 1e-9),
                          (1 - standing) / max(weight[~stays].sum(), 1e-9))
        return weight * shares / (weight * shares).sum()

    def reset(self, which, clips=None):
        """Starts episodes afresh, in clips of their own choice or in those given."""
        motion = self.motion
        for i, world in enumerate(which):
            clip = self.rng.choice(self.usable, p=self.weight) if clips is None else clips[i]
            last = motion.length(clip) - FUTURE - 3
            first = self.rng.integers(1, max(2, last)) if self.options.random_start else 1
            self.clip[world], self.age[world] = clip, 0
            self.frame[world] = motion.start[clip] + first
            self.lookahead[world] = self.rng.choice(self.options.lookaheads)
            self.hands[world] = self.rng.random() >= self.options.headset_only
            if self.options.misplaced:
                self.mounts[world] = self.rng.normal(0, self.options.misplaced, (PARTS, 3))
            self.fill(world)
            self.place(world)
            if self.options.jolted and self.rng.random() < self.options.jolted:
                self.jolt(world)
        self.refresh()

    def fill(self, world):
        """Puts the character of its clip into a world."""
        index = self.motion.character[self.clip[world]]
        character = self.motion.characters[index]
        if self.models[world] is not character.model:
            if self.data[world] is not None:
                self.spare.setdefault(self.models[world], []).append(self.data[world])
            spare = self.spare.get(character.model)
            self.data[world] = spare.pop() if spare else mujoco.MjData(character.model)
            self.models[world] = character.model
        self.offsets[world], self.stature[world] = character.offsets, character.stature
        self.torque[world] = character.torque

    def snapshot(self):
        """Everything that the worlds' future depends on, for `restore`."""
        size = mujoco.mj_stateSize(self.models[0], STATE)
        physics = np.empty((self.count, size))
        for world in range(self.count):
            mujoco.mj_getState(self.models[world], self.data[world], physics[world], STATE)
        kept = {name: getattr(self, name).copy() for name in CARRIED}
        return {"physics": physics, "random": self.rng.bit_generator.state, **kept}

    def restore(self, kept):
        """Goes on where `snapshot` was taken."""
        self.rng.bit_generator.state = kept["random"]
        for name in CARRIED:
            setattr(self, name, kept[name].copy())
        for world in range(self.count):
            self.fill(world)
            mujoco.mj_setState(self.models[world], self.data[world], kept["physics"][world], STATE)
            self.qpos[world] = self.data[world].qpos[:40]
            self.qvel[world] = self.data[world].qvel[:39]
        self.refresh()

    def place(self, world):
        """Puts a world's character where its reference is; `refresh` then sees it."""
        model, data, frame = self.models[world], self.data[world], self.frame[world]
        mujoco.mj_resetData(model, data)
        data.qpos[:40], data.qvel[:39] = self.motion.qpos[frame], self.motion.qvel[frame]
        mujoco.mj_forward(model, data)
        self._read(world)

    def jolt(self, world):
        """Puts a world's character off the reference: the head where it is, the feet elsewhere (no sole
        below the floor), as a tracker has it that sees no legs."""
        model, data, rng = self.models[world], self.data[world], self.rng
        character = self.motion.characters[self.motion.character[self.clip[world]]]
        qpos, still = data.qpos[None, :40].copy(), np.zeros((1, 39))

        def frames():
            return forward(character, character.offsets[None], qpos, still)

        before = frames()
        mujoco.mju_quatIntegrate(qpos[0, 3:7], rng.normal(0, JOLT_TILT, 3), 1.0)
        qpos[0, 7:] = np.clip(qpos[0, 7:] + rng.normal(0, JOLT_ANGLES, HINGES),
                              *character.ranges.T)
        qpos[0, [0, 2]] += (before.position - frames().position)[0, HEAD, [0, 2]]
        feet, turns = before.position[:, FEET].copy(), before.rotation[:, FEET].copy()
        feet[0, :, [0, 2]] += rng.normal(0, JOLT_FEET, (2, 2))
        yaw = np.zeros((2, 3))
        yaw[:, 1] = rng.normal(0, JOLT_YAW, 2)
        keep_feet(character, qpos, feet, rotation_exp(yaw) @ turns)
        qpos[0, 1] -= min(sole_corners(character, frames())[..., 1].min(), 0.0)
        data.qpos[:40] = qpos[0]
        data.qvel[:3] += rng.normal(0, JOLT_SPEED, 3)
        data.qvel[6:39] += rng.normal(0, JOLT_RATES, HINGES)
        mujoco.mj_forward(model, data)
        self._read(world)

    def _read(self, world):
        data = self.data[world]
        self.qpos[world], self.qvel[world] = data.qpos[:40], data.qvel[:39]
        self.feet[world] = data.sensordata[:6].reshape(2, 3) * FORCE_SIGN

    def refresh(self):
        """Places every link anew."""
        self.frames = forward(self.motion.characters[0], self.offsets, self.qpos, self.qvel)

    def coming(self, count):
        """(n, count) the next frames of the clips; the last one again where they end."""
        last = self.motion.start[self.clip + 1] - 1
        return np.minimum(self.frame[:, None] + np.arange(1, count + 1), last[:, None])

    def observe(self):
        """(n, 475)."""
        around = self.frame[:, None] + np.arange(-1, FUTURE + 1)
        last = self.motion.start[self.clip + 1] - 1
        around = np.minimum(around, last[:, None])
        turns = self.motion.parts_r[around]
        places = self.motion.parts_p[around] + rotate(turns, self.mounts[:, None])
        parts = future_parts(places, turns, self.lookahead)
        return observe(self.frames, self.qpos, self.qvel, self.feet, *parts, self.hands,
                       self.stature)

    def step(self, action):
        """Runs a policy step under action (n, 33) in -1 to 1.

        Gives reward terms (n, 5), lost (n,) and over (n,): the clip or the episode's time ended.
        Nothing is reset.
        """
        before = self.feet[:, :, 1].copy()
        control = np.clip(action, -1, 1) * self.torque
        broken = np.zeros(self.count, bool)
        if self.options.assist > 0:
            self._assist()
        for world in range(self.count):
            data = self.data[world]
            data.ctrl[:] = control[world]
            mujoco.mj_step(self.models[world], data, SUBSTEPS)
            sound = np.abs(data.qvel).max() < 1e3 and np.abs(data.qpos).max() < 1e4
            if not sound:
                broken[world] = True
                self.place(world)
            self._read(world)
        self.frame += 1
        self.age += 1
        self.refresh()
        terms = self.reward_terms(before)
        lost = broken | self._lost()
        end = self.motion.start[self.clip + 1] - FUTURE - 2
        over = (self.frame >= end) | (self.age >= self.options.steps_max)
        return terms, lost, over

    def reward_terms(self, feet_before):
        """(n, 5): the kernels of reward (4), each in 0 to 1.

        The paper's sums are taken as means over hinges and, for velocities, over links, and as a
        sum over links for positions: with plain sums a tenth of a radian on each hinge would
        already leave exp(-13).
        """
        motion, frame = self.motion, self.frame
        angles = np.square(self.qpos[:, 7:] - motion.qpos[frame, 7:]).mean(1)
        rates = np.square(self.qvel[:, 6:] - motion.qvel[frame, 6:]).mean(1)
        places = np.square(self.frames.position - motion.links[frame]).sum((1, 2))
        speeds = np.square(self.frames.linear - motion.speeds[frame]).sum(2).mean(1)
        unload = np.maximum(0, feet_before - self.feet[:, :, 1]).sum(1)
        return np.exp(-KERNELS * np.stack([angles, rates, places, speeds, unload], 1))

    def _lost(self):
        wanted = self.motion.links[self.frame][:, [PELVIS, HEAD]]
        apart = np.linalg.norm(self.frames.position[:, [PELVIS, HEAD]] - wanted, axis=-1)
        low = self.frames.position[:, PELVIS, 1] < FALLEN * wanted[:, 0, 1]
        return (apart.max(1) > self.options.lost) | low

    def _assist(self):
        """A spring and damper on the pelvis towards the reference."""
        motion, frame = self.motion, np.minimum(self.frame + 1, len(self.motion.qpos) - 1)
        push = (motion.qpos[frame, :3] - self.qpos[:, :3]) * 4000 \
            + (motion.qvel[frame, :3] - self.qvel[:, :3]) * 600
        wanted = quat_to_matrix(motion.qpos[frame][:, [4, 5, 6, 3]])
        here = self.frames.rotation[:, PELVIS]
        turn = rotation_log(wanted @ np.swapaxes(here, -1, -2)) * 800
        turn += (np.einsum("nij,nj->ni", wanted, motion.qvel[frame, 3:6])
                 - self.frames.angular[:, PELVIS]) * 80
        for world in range(self.count):
            applied = self.data[world].xfrc_applied[1]
            applied[:3] = np.clip(push[world], -800, 800) * self.options.assist
            applied[3:] = np.clip(turn[world], -300, 300) * self.options.assist


FORCE_SIGN = -1.0
"""The contact sensor gives what the foot does to the ground."""
