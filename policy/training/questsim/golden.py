"""Golden vectors that hold Rust's environment to this one.

`python -m questsim.golden MJCF STATURE OUT.json`, with MJCF from `references --mjcf STATURE`.
Each case: a state, eight frames of the user (the one before, the present one, six to come), what
the policy sees of it, an action, and the state and the observation after it.
"""

import json
import sys
from pathlib import Path

import mujoco
import numpy as np

from .character import Character, forward, quat_to_matrix
from .observation import FUTURE, SUBSTEPS, future_parts, observe
from .worlds import FORCE_SIGN

CASES = ((6, True), (2, True), (0, True), (6, False))


def some_quats(rng, spread, count):
    quats = np.concatenate([rng.normal(0, spread, (count, 3)), np.ones((count, 1))], 1)
    return quats / np.linalg.norm(quats, axis=1, keepdims=True)


def user(rng):
    """Positions (8, 3, 3) and quaternions (8, 3, 4) of a user who moves smoothly."""
    steps = np.arange(-1, FUTURE + 1)[:, None, None]
    base = np.array([[0.3, 1.6, -0.2], [0.0, 1.1, -0.4], [0.6, 1.2, -0.3]])
    position = base + steps * rng.normal(0, 0.02, (1, 3, 3)) + steps**2 * rng.normal(0, 0.002, (1, 3, 3))
    turn = steps * rng.normal(0, 0.03, (1, 3, 3)) + rng.normal(0, 0.4, (1, 3, 3))
    quats = np.concatenate([turn, np.ones((FUTURE + 2, 3, 1))], -1)
    return position, quats / np.linalg.norm(quats, axis=-1, keepdims=True)


def see(character, data, parts, hands):
    qpos, qvel = data.qpos[None, :40], data.qvel[None, :39]
    frames = forward(character, character.offsets[None], qpos, qvel)
    feet = data.sensordata[:6].reshape(1, 2, 3) * FORCE_SIGN
    return observe(frames, qpos, qvel, feet, *parts, np.array([hands]),
                   np.array([character.stature]))[0]


def case(character, rng, lookahead, hands):
    model, data = character.model, mujoco.MjData(character.model)
    height = data.qpos[1]
    data.qpos[:3] = rng.normal(0, 0.3, 3) * [1, 0, 1] + [0, height - 0.004, 0]
    yaw = rng.uniform(-3, 3)
    data.qpos[3:7] = [np.cos(yaw / 2), 0, np.sin(yaw / 2), 0]
    low, high = character.ranges.T
    data.qpos[7:] = np.clip(rng.normal(0, 0.1, 33), low, high)
    data.qvel[:] = rng.normal(0, 0.5, 39)
    mujoco.mj_forward(model, data)
    position, quats = user(rng)
    parts = future_parts(position[None], quat_to_matrix(quats)[None], np.array([lookahead]))
    out = {"lookahead": lookahead, "hands": hands, "qpos": data.qpos.tolist(),
           "qvel": data.qvel.tolist(), "positions": position.tolist(), "quats": quats.tolist(),
           "observation": see(character, data, parts, hands).tolist()}
    action = rng.uniform(-0.4, 0.4, 33)
    data.ctrl[:] = action * character.torque
    mujoco.mj_step(model, data, SUBSTEPS)
    return out | {"action": action.tolist(), "qpos_next": data.qpos.tolist(),
                  "qvel_next": data.qvel.tolist(),
                  "observation_next": see(character, data, parts, hands).tolist()}


def main():
    mjcf, stature, out = sys.argv[1:]
    text = Path(mjcf).read_text()
    character = Character.from_mjcf(text, float(stature))
    rng = np.random.default_rng(7)
    cases = [case(character, rng, *options) for options in CASES]
    Path(out).write_text(json.dumps({"stature": float(stature), "mjcf": text, "cases": cases}))


if __name__ == "__main__":
    main()
