"""Many worlds, each a character that shall follow a clip: the environment of training.

A policy step is 1/36 s in four physics steps of 1/144 s under constant torques. Episodes start
anywhere in a clip, in its pose and moving with it, and end with the clip, after `steps_max`, or
early when the character has lost the motion.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from .character import HEAD, HINGES, LINKS, PELVIS, forward, rotation_log, quat_to_matrix
from .observation import FUTURE, SUBSTEPS, future_parts, observe

LOST = 0.5
"""An episode ends when pelvis or head are so far from the reference, metres."""
FALLEN = 0.55
"""It ends too when the pelvis is below this share of its height in the reference."""
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


class Worlds:
    """`count` worlds on `motion`."""

    def __init__(self, motion, count, seed=0, options=None):
        self.motion, self.count = motion, count
        self.options = options or Options()
        self.rng = np.random.default_rng(seed)
        self.pool = [{} for _ in range(count)]
        self.data = [None] * count
        self.models = [None] * count
        self.clip = np.zeros(count, np.int64)
        self.frame = np.zeros(count, np.int64)
        self.age = np.zeros(count, np.int64)
        self.lookahead = np.zeros(count, np.int64)
        self.hands = np.ones(count, bool)
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
        self.reset(np.arange(count))

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
            index = motion.character[clip]
            character = motion.characters[index]
            if index not in self.pool[world]:
                self.pool[world][index] = mujoco.MjData(character.model)
            self.data[world], self.models[world] = self.pool[world][index], character.model
            self.offsets[world], self.stature[world] = character.offsets, character.stature
            self.torque[world] = character.torque
            self.place(world)
        self.refresh()

    def place(self, world):
        """Puts a world's character where its reference is; `refresh` then sees it."""
        model, data, frame = self.models[world], self.data[world], self.frame[world]
        mujoco.mj_resetData(model, data)
        data.qpos[:40], data.qvel[:39] = self.motion.qpos[frame], self.motion.qvel[frame]
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
        parts = future_parts(self.motion.parts_p[around], self.motion.parts_r[around],
                             self.lookahead)
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
