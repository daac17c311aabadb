"""A student, or the expert, over whole clips: how often it falls and how far off it is.

`python -m questsim.evaluate --motion MOTION.npz --checkpoint RUN/state.pt`
"""

import argparse
import json

import numpy as np
import torch

from .expert import Expert
from .mirror import Symmetric
from .motion import Motion
from .observation import FUTURE
from .student import Mlp
from .worlds import Options, Worlds


def play(motion, act, clips, lookahead, hands):
    """Each clip once from its start; figures of every clip. `act(worlds)` gives actions."""
    options = Options(lookaheads=(lookahead,), headset_only=0.0 if hands else 1.0,
                      steps_max=10**9, random_start=False)
    worlds = Worlds(motion, len(clips), 0, options)
    worlds.reset(np.arange(len(clips)), clips)
    actor = act(worlds)
    falls, steps = np.zeros(len(clips)), np.zeros(len(clips))
    error = np.zeros(len(clips))
    going = np.ones(len(clips), bool)
    while going.any():
        _, lost, over = worlds.step(actor())
        steps += going
        apart = np.linalg.norm(worlds.frames.position - motion.links[worlds.frame], axis=-1)
        error += going * np.where(lost, 0, apart.mean(1))
        falls += going & lost
        for world in np.flatnonzero(going & lost):
            # Put back where the reference is, as the tracker does.
            worlds.place(world)
        worlds.refresh()
        going &= ~over
        # Those that are through wait at the end of their clips.
        worlds.frame = np.minimum(worlds.frame, motion.start[worlds.clip + 1] - FUTURE - 3)
    return falls, steps, 100 * error / np.maximum(steps, 1)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--motion", required=True)
    parser.add_argument("--checkpoint", help="without it the expert drives")
    parser.add_argument("--clips", type=int, default=32)
    parser.add_argument("--lookahead", type=int, default=6)
    parser.add_argument("--headset-only", action="store_true")
    args = parser.parse_args()
    torch.set_num_threads(1)
    motion = Motion.read(args.motion)
    clips = np.arange(0, len(motion), max(1, len(motion) // args.clips))[:args.clips]
    if args.checkpoint:
        student = Mlp()
        student.load_state_dict(torch.load(args.checkpoint, weights_only=True)["student"])
        policy = Symmetric(student)

        @torch.no_grad()
        def ask(worlds):
            seen = torch.from_numpy(worlds.observe().astype(np.float32))
            return policy(seen).numpy()

        def act(worlds):
            return lambda: ask(worlds)
    else:
        def act(worlds):
            return Expert(worlds).act
    falls, steps, error = play(motion, act, clips, args.lookahead, not args.headset_only)
    print(json.dumps({
        "clips": len(clips), "minutes": steps.sum() / 36 / 60,
        "falls_per_minute": falls.sum() / steps.sum() * 36 * 60,
        "unbroken": float((falls == 0).mean()), "link_error_cm": float(error.mean())}))


if __name__ == "__main__":
    main()
