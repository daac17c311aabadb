"""Moves the pelvis of reference motion to where the ground can carry it.

Recorded people have toes, other masses and measurement errors: on the physics character their
motion asks for ground forces outside the soles. Where the body is, far more than how it moves,
decides that: a pelvis moved by d moves the zero-moment point by d - (h/g) d'' (the linear
inverted pendulum of Kajita et al., ICRA 2003). A few centimetres, found for the whole clip at
once, suffice.
"""

import mujoco
import numpy as np
from scipy.linalg import solveh_banded

from .character import FEET, LEGS, forward, rotate, rotation_log

GRAVITY = 9.81
ROUNDS = 3
STIFFNESS = 0.2
"""Metres of zero-moment point that a metre of moved pelvis costs."""
INSIDE = 0.015
"""How far inside the soles' hull the zero-moment point is to stay, metres."""
FARTHEST = 0.25
"""A zero-moment point farther outside counts as if it were so far, metres."""
LOW = 0.05
"""Sole corners below this carry, metres."""
CARRIES = 0.2
"""Share of the weight under which a frame has no zero-moment point worth the name."""
REACH_ROUNDS, REACH_DAMPING, REACH_STEP = 8, 3e-3, 0.1
"""Of the damped steps that bend the legs; the last in radians a round."""


def zero_moment_point(character, qpos, qvel, qacc):
    """(frames, 2) x and z on the floor, metres, and (frames,) vertical force over weight.

    There the ground would have to push: r x f = moment about the pelvis, at height zero.
    """
    model, data = character.model, mujoco.MjData(character.model)
    flags = model.opt.disableflags
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    weight = GRAVITY * mujoco.mj_getTotalmass(model)
    force, moment = np.empty((len(qpos), 3)), np.empty((len(qpos), 3))
    for frame in range(len(qpos)):
        data.qpos[:40], data.qvel[:39], data.qacc[:39] = qpos[frame], qvel[frame], qacc[frame]
        mujoco.mj_inverse(model, data)
        force[frame] = data.qfrc_inverse[:3]
        moment[frame] = data.xmat[1].reshape(3, 3) @ data.qfrc_inverse[3:6]
    model.opt.disableflags = flags
    down = np.maximum(force[:, 1], CARRIES * weight)
    x = qpos[:, 0] + (moment[:, 2] - qpos[:, 1] * force[:, 0]) / down
    z = qpos[:, 2] + (-moment[:, 0] - qpos[:, 1] * force[:, 2]) / down
    return np.stack([x, z], 1), force[:, 1] / weight


def into_hull(point, corners, valid):
    """How to move each point into the hull of its corners: (n, 2) for (n, 2), (n, k, 2), (n, k)."""
    n, k, _ = corners.shape
    count = np.maximum(valid.sum(1), 1)[:, None]
    centre = (corners * valid[..., None]).sum(1) / count
    # Corners that do not count lie on one that does; all are drawn inside.
    first = valid.argmax(1)
    corners = np.where(valid[..., None], corners, corners[np.arange(n), first][:, None])
    outward = corners - centre[:, None]
    length = np.linalg.norm(outward, axis=-1, keepdims=True)
    corners = centre[:, None] + outward * np.maximum(0, 1 - INSIDE / np.maximum(length, 1e-6))
    a, b = np.triu_indices(k, 1)
    along = corners[:, b] - corners[:, a]
    share = ((point[:, None] - corners[:, a]) * along).sum(-1)
    share = np.clip(share / np.maximum(np.square(along).sum(-1), 1e-12), 0, 1)
    nearest = corners[:, a] + share[..., None] * along
    apart = np.linalg.norm(nearest - point[:, None], axis=-1)
    best = nearest[np.arange(n), apart.argmin(1)]
    # Inside: seen from the point, the corners leave no gap of half a turn.
    angle = np.sort(np.arctan2(*np.moveaxis(corners - point[:, None], -1, 0)), 1)
    gap = np.diff(np.concatenate([angle, angle[:, :1] + 2 * np.pi], 1), axis=1).max(1)
    move = np.where((gap < np.pi)[:, None], 0, best - point)
    size = np.linalg.norm(move, axis=1, keepdims=True)
    return move * np.minimum(1, FARTHEST / np.maximum(size, 1e-9))


def pelvis_shift(wanted, trust, height, rate):
    """(n, 2) shift of the pelvis that moves the zero-moment point by `wanted` (n, 2)."""
    n = len(wanted)
    k = height / GRAVITY * rate**2
    # Rows t of A: d_t - k (d_{t-1} - 2 d_t + d_{t+1}); the ends are free.
    main = np.full(n, 1 + 2 * k)
    main[[0, -1]] = 1 + k
    w = np.square(trust)
    bands = np.zeros((3, n))
    # A is symmetric: A W A has two side diagonals.
    bands[2] = w * main**2 + STIFFNESS**2
    bands[2, 1:] += w[:-1] * k**2
    bands[2, :-1] += w[1:] * k**2
    bands[1, 1:] = -k * (w[:-1] * main[:-1] + w[1:] * main[1:])
    bands[0, 2:] = w[1:-1] * k**2
    right = w[:, None] * wanted
    product = main[:, None] * right
    product[1:] -= k * right[:-1]
    product[:-1] -= k * right[1:]
    return solveh_banded(bands, product)


def keep_feet(character, qpos, position, rotation):
    """Bends the legs of qpos (n, 40), in place, until the feet are where they were.

    position (n, 2, 3), rotation (n, 2, 3, 3) of the feet.
    """
    offsets = np.broadcast_to(character.offsets, (len(qpos), *character.offsets.shape))
    still = np.zeros((len(qpos), 39))
    least, greatest = character.ranges.T
    for _ in range(REACH_ROUNDS):
        frames = forward(character, offsets, qpos, still)
        for leg, (foot, hinges) in enumerate(zip(FEET, LEGS)):
            place = frames.position[:, foot]
            turn = rotation_log(rotation[:, leg] @ np.swapaxes(frames.rotation[:, foot], -1, -2))
            error = np.concatenate([position[:, leg] - place, 0.3 * turn], 1)
            jacobian = np.zeros((len(qpos), 6, 6))
            for column, hinge in enumerate(range(hinges.start, hinges.stop)):
                link = character.link_of(hinge)
                axis = frames.axes[:, hinge]
                jacobian[:, :3, column] = np.cross(axis, place - frames.position[:, link])
                jacobian[:, 3:, column] = 0.3 * axis
            back = np.swapaxes(jacobian, -1, -2)
            square = back @ jacobian + REACH_DAMPING * np.eye(6)
            step = np.linalg.solve(square, rotate(back, error)[..., None])
            columns = slice(7 + hinges.start, 7 + hinges.stop)
            qpos[:, columns] = np.clip(
                qpos[:, columns] + np.clip(step[..., 0], -REACH_STEP, REACH_STEP),
                least[hinges], greatest[hinges])


def accelerations(qvel, rate):
    """(n, 39) by central differences."""
    after = np.minimum(np.arange(len(qvel)) + 1, len(qvel) - 1)
    before = np.maximum(np.arange(len(qvel)) - 1, 0)
    return (qvel[after] - qvel[before]) * rate / np.maximum(after - before, 1)[:, None]


def balance(character, qpos, stands, velocities, corners, rate):
    """Moves the pelvis and bends the legs of qpos (n, 40), in place; the feet stay.

    stands (n, 2) bool; velocities: qpos to (n, 39); corners: (n, 2, 4, 3) of the soles.
    """
    still = np.zeros((len(qpos), 39))
    offsets = np.broadcast_to(character.offsets, (len(qpos), *character.offsets.shape))
    before = forward(character, offsets, qpos, still)
    feet, turns = before.position[:, FEET].copy(), before.rotation[:, FEET].copy()
    flat = corners.reshape(len(qpos), 8, 3)
    valid = np.repeat(stands, 4, 1) & (flat[..., 1] < LOW)
    for _ in range(ROUNDS):
        qvel = velocities(qpos)
        point, load = zero_moment_point(character, qpos, qvel, accelerations(qvel, rate))
        trust = np.where(valid.any(1), np.clip(load, CARRIES, 1), CARRIES / 2)
        move = np.where(valid.any(1)[:, None], into_hull(point, flat[..., [0, 2]], valid), 0)
        shift = pelvis_shift(move, trust, qpos[:, 1].mean(), rate)
        qpos[:, [0, 2]] += shift
        keep_feet(character, qpos, feet, turns)
