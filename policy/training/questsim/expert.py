"""A dense, privileged expert: torques that make the whole body follow the reference.

It knows the reference motion and the state exactly and needs no training: desired accelerations
from a spring and damper about the reference on every coordinate, feet that stand stay, feet that
swing are set where the pelvis's error wants them, contact forces within the friction cone that
come closest to what the pelvis needs, and the torques of the inverse dynamics that go with them.
There is no force on the pelvis: what the soles cannot push, the body does not do.
"""

import mujoco
import numpy as np

from .character import FEET, LEGS, quat_to_matrix, rotate, rotation_log, skew
from .observation import RATE

FRICTION = 0.8
TOUCH, LIFTS = 0.015, 0.02
"""Sole corners may push below the first, unless the reference lifts them the second above the
foot's lowest, metres."""
EARLY, LOADED = 4, 30.0
"""A swinging foot with this force on it (N) has landed if the reference lands within so many steps."""
KNEE, STRAIGHT = 3, 0.25
"""A leg's hinge that bends the knee, and the angle (rad) below which it counts as nearly straight."""
REACH, AHEAD = 0.985, 0.05
"""Share of a leg's length that it is stretched to at most, so many seconds ahead."""
CLEARANCE, RISE, FALL, LANDING = 0.03, 0.01, 0.008, 0.0
"""Height of swinging feet, what they rise and fall by in a step, and below what one has landed
that is about to stand, metres."""
RIDGE = 1e-3
"""Keeps forces spread where many would do."""
ITERATIONS, PENALTY = 50, 0.1
"""Of the alternating directions that find the contact forces."""
WRENCH_WEIGHT = np.array([1.0, 1.0, 1.0, 10.0, 10.0, 10.0])
"""Of force (N) and moment (N m) on the pelvis."""


def sole_heights(motion):
    """(frames, 2, 4) of the reference's sole corners, metres."""
    points = np.stack([c.sole_points for c in motion.characters])[motion.character]
    out = np.empty((len(motion.qpos), 2, 4))
    for clip in range(len(motion)):
        frames = slice(motion.start[clip], motion.start[clip + 1])
        corners = rotate(motion.foot_rotation[frames][:, :, None], points[clip][None])
        out[frames] = motion.links[frames][:, FEET][..., 1:2] + corners[..., 1]
    return out


def clearance(motion, lowest):
    """(frames, 2) metres that a swinging foot is to be higher than in the reference."""
    out = np.zeros(motion.stands.shape)
    for clip in range(len(motion)):
        a, b = motion.start[clip], motion.start[clip + 1]
        low = lowest[a:b]
        for leg in range(2):
            # Frames to the end of the swing, the last low ones counted as landed.
            landed = np.where(motion.stands[a:b, leg], 0, 100)
            for frame in range(b - a - 2, -1, -1):
                if landed[frame]:
                    ahead = landed[frame + 1]
                    landed[frame] = 0 if ahead == 0 and low[frame, leg] < LANDING else ahead + 1
            gone = np.where(motion.stands[a:b, leg], 0, 100)
            for frame in range(1, b - a):
                gone[frame] = min(gone[frame], gone[frame - 1] + 1)
            wanted = np.minimum(CLEARANCE, np.minimum(RISE * gone, FALL * landed))
            out[a:b, leg] = np.where(landed > 0, np.maximum(0, wanted - low[:, leg]), 0)
    return out


class Gains:
    """Springs (1/s²) and dampers (1/s)."""

    joint = (120.0, 20.0)
    root = (30.0, 18.0)
    turn = (150.0, 24.0)
    swing = (150.0, 22.0)
    hold = 12.0
    place = 0.42
    """A swinging foot is moved by this time times the pelvis's velocity error, seconds."""


class Expert:
    """Torques for `worlds`, as actions in -1 to 1."""

    def __init__(self, worlds, gains=Gains):
        self.worlds, self.gains = worlds, gains
        motion = worlds.motion
        after = np.minimum(np.arange(len(motion.qpos)) + 1, len(motion.qpos) - 1)
        self.qacc = (motion.qvel[after] - motion.qvel) * RATE
        self.qacc[motion.start[1:] - 1] = 0
        self.heights = sole_heights(motion)
        self.clear = clearance(motion, self.heights.min(2))

    def dynamics(self):
        """Mass matrices (n, 39, 39) and bias less passive forces (n, 39)."""
        n = self.worlds.count
        mass, force = np.zeros((n, 39, 39)), np.zeros((n, 39))
        full, bias = np.zeros((39, 39)), np.zeros(39)
        for world in range(n):
            model, data = self.worlds.models[world], self.worlds.data[world]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_makeM(model, data)
            mujoco.mj_comVel(model, data)
            mujoco.mj_passive(model, data)
            mujoco.mj_rne(model, data, 0, bias)
            mujoco.mj_fullM(model, data, full)
            mass[world], force[world] = full, bias - data.qfrc_passive
            # What the joints' damping takes away by the middle of the step.
            mass[world, np.arange(6, 39), np.arange(6, 39)] += model.dof_damping[6:39] / (2 * RATE)
        return mass, force

    def act(self):
        """Actions (n, 33)."""
        worlds, gains, motion = self.worlds, self.gains, self.worlds.motion
        frame, n = worlds.frame, worlds.count
        frames, qpos, qvel = worlds.frames, worlds.qpos, worlds.qvel
        ref_q, ref_v, ref_a = motion.qpos[frame], motion.qvel[frame], self.qacc[frame]
        mass, force = self.dynamics()
        rotation = frames.rotation[:, 0]
        ref_rotation = quat_to_matrix(ref_q[:, [4, 5, 6, 3]])
        # Desired accelerations of pelvis and hinges.
        want = np.zeros((n, 39))
        place, speed = self.within_reach(ref_q[:, :3], ref_v[:, :3])
        want[:, :3] = ref_a[:, :3] + gains.root[0] * (place - qpos[:, :3]) \
            + gains.root[1] * (speed - qvel[:, :3])
        back = np.swapaxes(rotation, -1, -2)
        turn = rotation_log(back @ ref_rotation)
        spin = rotate(back, rotate(ref_rotation, ref_v[:, 3:6])) - qvel[:, 3:6]
        want[:, 3:6] = ref_a[:, 3:6] + gains.turn[0] * turn + gains.turn[1] * spin
        want[:, 6:] = ref_a[:, 6:] + gains.joint[0] * (ref_q[:, 7:] - qpos[:, 7:]) \
            + gains.joint[1] * (ref_v[:, 6:] - qvel[:, 6:])
        # The legs: acceleration of the hinges = c + A times acceleration of the pelvis.
        legs_c, legs_a, corners, stands = self.legs(want, ref_q, ref_v)
        base_m = mass[:, :6, :6].copy()
        others = slice(6, 6 + LEGS[0].start)
        fixed = rotate(mass[:, :6, others], want[:, others]) + force[:, :6]
        for leg, hinges in enumerate(LEGS):
            columns = np.arange(hinges.start, hinges.stop) + 6
            base_m += mass[:, :6, columns] @ legs_a[leg]
            fixed += rotate(mass[:, :6, columns], legs_c[leg])
        needed = rotate(base_m, want[:, :6]) + fixed
        push = self.contact_forces(needed, corners, stands)
        wrench = self.wrench(push, corners)
        got = np.linalg.solve(base_m, (wrench - fixed)[..., None])[..., 0]
        want[:, :6] = got
        for leg, hinges in enumerate(LEGS):
            columns = slice(hinges.start + 6, hinges.stop + 6)
            want[:, columns] = legs_c[leg] + rotate(legs_a[leg], got)
        torque = rotate(mass[:, 6:], want) + force[:, 6:]
        for leg, hinges in enumerate(LEGS):
            for hinge in range(hinges.start, hinges.stop):
                arm = corners[:, leg] - self.hinge_place(hinge)[:, None]
                moment = np.cross(arm, push[:, leg]).sum(1)
                torque[:, hinge] -= (frames.axes[:, hinge] * moment).sum(-1)
        return np.clip(torque / worlds.torque, -1, 1)

    def within_reach(self, place, speed):
        """The pelvis's goal, lowered to where the legs that stand stay a little bent."""
        worlds, frames = self.worlds, self.worlds.frames
        place, speed = place.copy(), speed.copy()
        root = frames.position[:, 0]
        for leg, foot in enumerate(FEET):
            hip, ankle = frames.position[:, foot - 2], frames.position[:, foot]
            length = REACH * (np.linalg.norm(worlds.offsets[:, foot - 1], axis=-1)
                              + np.linalg.norm(worlds.offsets[:, foot], axis=-1))
            apart = (hip - ankle) + AHEAD * (frames.linear[:, foot - 2] - frames.linear[:, foot])
            aside = np.square(apart[:, [0, 2]]).sum(1)
            highest = ankle[:, 1] + np.sqrt(np.maximum(np.square(length) - aside, 0.04)) \
                - (hip[:, 1] - root[:, 1])
            bound = (worlds.feet[:, leg, 1] > LOADED) & (place[:, 1] > highest)
            place[:, 1] = np.where(bound, highest, place[:, 1])
            speed[:, 1] = np.where(bound, np.minimum(speed[:, 1], 0), speed[:, 1])
        return place, speed

    def hinge_place(self, hinge):
        character = self.worlds.motion.characters[0]
        return self.worlds.frames.position[:, character.link_of(hinge)]

    def legs(self, want, ref_q, ref_v):
        """Each leg's hinge accelerations as an affine function of the pelvis's."""
        worlds, gains, motion = self.worlds, self.gains, self.worlds.motion
        frames, frame, n = worlds.frames, worlds.frame, worlds.count
        later = worlds.coming(1)[:, 0]
        points = np.stack([c.sole_points for c in motion.characters])[motion.character[worlds.clip]]
        corners = frames.position[:, FEET, None] + rotate(
            frames.rotation[:, FEET, None], points)
        low = corners[..., 1].min(2) < TOUCH
        planned = motion.stands[frame] & motion.stands[later]
        # A foot that lands early stays where it is, one that is to leave may.
        soon = motion.stands[worlds.coming(EARLY)].any(1)
        stands = low & (planned | (soon & (worlds.feet[:, :, 1] > LOADED)))
        rotation, root = frames.rotation[:, 0], frames.position[:, 0]
        drift = frames.linear[:, 0] - motion.speeds[frame, 0]
        out_c, out_a = [], []
        for leg, hinges in enumerate(LEGS):
            foot = FEET[leg]
            # A standing foot turns about where it presses, a swinging one about its ankle.
            weight = np.exp(-(corners[:, leg, :, 1] + self.heights[later, leg]) / 0.008)
            weight /= np.maximum(weight.sum(1, keepdims=True), 1e-12)
            pressed = (corners[:, leg] * weight[..., None]).sum(1)
            place = np.where(stands[:, leg, None], pressed, frames.position[:, foot])
            arm = place - frames.position[:, foot]
            speed = frames.linear[:, foot] + np.cross(frames.angular[:, foot], arm)
            goal = motion.links[later, foot] + 0.0
            goal_speed = motion.speeds[later, foot]
            shift = (frames.position[:, 0] - motion.links[frame, 0]) + gains.place * drift
            goal[:, [0, 2]] += shift[:, [0, 2]]
            goal[:, 1] += self.clear[later, leg]
            goal_speed = goal_speed.copy()
            goal_speed[:, 1] += (self.clear[later, leg] - self.clear[frame, leg]) * RATE
            swing = gains.swing[0] * (goal - place) + gains.swing[1] * (goal_speed - speed) \
                + (goal_speed - motion.speeds[frame, foot]) * RATE
            linear = np.where(stands[:, leg, None], -gains.hold * speed, swing)
            ref_turn, ref_spin = self.foot_reference(foot, frame)
            angular = gains.turn[0] * rotation_log(
                ref_turn @ np.swapaxes(frames.rotation[:, foot], -1, -2)) \
                + gains.turn[1] * (ref_spin - frames.angular[:, foot]) \
                + (self.foot_reference(foot, later)[1] - ref_spin) * RATE
            columns = range(hinges.start, hinges.stop)
            jacobian = np.zeros((n, 6, 6))
            for column, hinge in enumerate(columns):
                axis = frames.axes[:, hinge]
                jacobian[:, :3, column] = np.cross(axis, place - self.hinge_place(hinge))
                jacobian[:, 3:, column] = axis
            base = np.zeros((n, 6, 6))
            base[:, :3, :3] = np.eye(3)
            base[:, :3, 3:] = -skew(place - root) @ rotation
            base[:, 3:, 3:] = rotation
            task = np.concatenate([linear, angular], 1) - self.swirl(leg, place)
            # Damped least squares about the hinges' own wishes; metres count ten times radians.
            scale = np.array([10.0, 10, 10, 1, 1, 1])[:, None]
            j = jacobian * scale
            # A knee that is nearly straight follows its own wish: it could be told to bend backwards.
            bend = worlds.qpos[:, 7 + hinges.start + KNEE]
            damping = np.full((n, 6), 0.02)
            damping[:, KNEE] += 10 * np.exp(-np.square(np.maximum(bend, 0) / STRAIGHT))
            solve = np.linalg.solve(np.swapaxes(j, -1, -2) @ j + damping[:, None] * np.eye(6),
                                    np.swapaxes(j, -1, -2) * scale[:, 0])
            wish = want[:, 6 + hinges.start:6 + hinges.stop]
            rest = task - rotate(jacobian, wish)
            out_c.append(wish + rotate(solve, rest))
            out_a.append(-solve @ base)
        return out_c, out_a, corners, stands

    def foot_reference(self, foot, frame):
        """Rotation and spin of a foot in the reference."""
        side, motion = FEET.index(foot), self.worlds.motion
        return motion.foot_rotation[frame, side], motion.foot_spin[frame, side]

    def swirl(self, leg, place):
        """(n, 6) acceleration at `place` on a foot with all coordinates' accelerations zero."""
        frames, character = self.worlds.frames, self.worlds.motion.characters[0]
        qvel = self.worlds.qvel
        linear = np.zeros((len(qvel), 3))
        angular = np.zeros_like(linear)
        parent = 0
        for link in range(FEET[leg] - 2, FEET[leg] + 1):
            arm = frames.position[:, link] - frames.position[:, parent]
            omega = frames.angular[:, parent]
            linear += np.cross(angular, arm) + np.cross(omega, np.cross(omega, arm))
            spin = omega.copy()
            for hinge in character.hinges[link]:
                own = frames.axes[:, hinge] * qvel[:, 6 + hinge, None]
                angular += np.cross(spin, own)
                spin += own
            parent = link
        arm, omega = place - frames.position[:, parent], frames.angular[:, parent]
        linear += np.cross(angular, arm) + np.cross(omega, np.cross(omega, arm))
        return np.concatenate([linear, angular], 1)

    def contact_forces(self, needed, corners, stands):
        """(n, 2, 4, 3) forces in the friction cone whose wrench comes closest to `needed`."""
        n = len(needed)
        rays = np.array([[FRICTION, 1, 0], [-FRICTION, 1, 0], [0, 1, FRICTION], [0, 1, -FRICTION]])
        planned = self.heights[self.worlds.coming(1)[:, 0]]
        # A corner that the reference is about to lift pushes no more.
        allowed = stands[:, :, None] & (corners[..., 1] < TOUCH) \
            & (planned - planned.min(2, keepdims=True) < LIFTS)
        allowed = allowed.reshape(n, 8)
        arms = corners.reshape(n, 8, 3) - self.worlds.frames.position[:, :1]
        back = np.swapaxes(self.worlds.frames.rotation[:, 0], -1, -2)
        moment = np.cross(arms[:, :, None], rays)
        moment = rotate(back[:, None, None], moment)
        columns = np.concatenate([np.broadcast_to(rays, moment.shape), moment], -1)
        columns = columns.reshape(n, 32, 6) * WRENCH_WEIGHT
        target = needed * WRENCH_WEIGHT
        columns *= np.repeat(allowed, 4, 1)[..., None]
        share = cone_least_squares(columns, target)
        force = (share.reshape(n, 8, 4, 1) * rays).sum(2) * allowed[..., None]
        return force.reshape(n, 2, 4, 3)

    def wrench(self, push, corners):
        """(n, 6) of the corners' forces on the pelvis's coordinates."""
        root, rotation = self.worlds.frames.position[:, 0], self.worlds.frames.rotation[:, 0]
        moment = np.cross(corners - root[:, None, None], push).sum((1, 2))
        return np.concatenate([push.sum((1, 2)), rotate(np.swapaxes(rotation, -1, -2), moment)], 1)



def cone_least_squares(columns, target):
    """min |sum_i share_i columns_i - target|², share >= 0, by alternating directions.

    columns (n, k, m), target (n, m); gives (n, k).
    """
    n, k, _ = columns.shape
    gram = columns @ np.swapaxes(columns, -1, -2)
    inverse = np.linalg.inv(gram + (RIDGE + PENALTY) * np.eye(k))
    wish = rotate(columns, target)
    share, dual = np.zeros((n, k)), np.zeros((n, k))
    for _ in range(ITERATIONS):
        free = rotate(inverse, wish + PENALTY * (share - dual))
        share = np.maximum(free + dual, 0)
        dual += free - share
    return share
