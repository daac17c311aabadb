"""Stage (c): the expert's torques taught to the student (DAgger, Ross et al. 2011).

Each round plays episodes, mostly with the student at the wheel, asks the expert what it would
have done in every state, and trains on all that was ever answered, and on its mirror image. A round
depends on the weights before it and on its number alone: killed and started again, the curve is the
same.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import torch

from common import checkpoint
from common.average import Average
from common.beside import Beside
from common.log import record
from common.optimizer import MuonAdamW

from .expert import Expert
from .mirror import Mirror, Symmetric
from .motion import Motion
from .student import LAST, Mlp
from .worlds import LOOKAHEADS, Worlds, practice, practice_arguments

NOISE = 0.05
"""Spread of what is added to the driver's action in half of the worlds."""


class Memory:
    """The last `keep` rounds, in float16."""

    def __init__(self, keep):
        self.keep, self.inputs, self.labels = keep, [], []

    def add(self, inputs, labels):
        """A round's observations (n, 475) and answers (n, 33), float16."""
        self.inputs.append(torch.from_numpy(inputs))
        self.labels.append(torch.from_numpy(labels))
        del self.inputs[:-self.keep], self.labels[:-self.keep]

    def pick(self, count, generator):
        """`count` samples from all rounds, each as likely as any other, float32."""
        ends = torch.tensor([len(i) for i in self.inputs]).cumsum(0)
        chosen = torch.randint(int(ends[-1]), (count,), generator=generator).sort().values
        rounds = torch.searchsorted(ends, chosen, right=True)
        inputs, labels = [], []
        for number in rounds.unique().tolist():
            begin = int(ends[number]) - len(self.inputs[number])
            rows = chosen[rounds == number] - begin
            inputs.append(self.inputs[number][rows])
            labels.append(self.labels[number][rows])
        return torch.cat(inputs).float(), torch.cat(labels).float()


class Player:
    """Plays a round's episodes; lives in a process of its own, so that playing and learning share
    two cores."""

    def __init__(self, motion, args):
        self.motion, self.args = motion, args
        self.student = Mlp()

    def play(self, number, weights):
        """Observations (n, 475), the expert's answers (n, 33), both float16, and figures."""
        args, began = self.args, time.perf_counter()
        self.student.load_state_dict(weights)
        driver = Symmetric(self.student)
        rng = np.random.default_rng((args.seed, number))
        worlds = Worlds(self.motion, args.worlds, (args.seed, number, 1),
                        practice(args))
        expert = Expert(worlds)
        # Half of the worlds follow the expert at first, a tenth of them later.
        share = 0.1 if taught(args) else max(0.1, args.share ** (number + 1))
        led = rng.random(args.worlds) < share
        shaken = rng.random(args.worlds) < 0.5
        inputs, labels, lost_count, steps = [], [], 0, 0
        rewards = []
        for _ in range(args.steps):
            seen = worlds.observe().astype(np.float32)
            answer = expert.act().astype(np.float32)
            with torch.no_grad():
                own = driver(torch.from_numpy(seen)).numpy()
            keep = (worlds.lookahead.copy(), worlds.hands.copy())
            worlds.lookahead = rng.choice(LOOKAHEADS, args.worlds)
            worlds.hands = rng.random(args.worlds) < 0.75
            # The same state seen through other devices: a second sample for nothing.
            inputs += [seen, worlds.observe().astype(np.float32)]
            labels += [answer, answer]
            worlds.lookahead, worlds.hands = keep
            action = np.where(led[:, None], answer, own)
            action = action + shaken[:, None] * rng.normal(0, NOISE, action.shape)
            terms, lost, over = worlds.step(action)
            rewards.append(terms[~led].mean(0) if (~led).any() else terms.mean(0))
            lost_count += int((lost & ~led).sum())
            steps += int((~led).sum())
            again = np.flatnonzero(lost | over)
            if len(again):
                worlds.reset(again)
        figures = {"falls_per_minute": lost_count / max(steps, 1) * 36 * 60,
                   "terms": np.mean(rewards, 0).round(3).tolist(), "led": float(led.mean()),
                   "play_s": time.perf_counter() - began}
        inputs, labels = np.concatenate(inputs), np.concatenate(labels)
        return inputs.astype(np.float16), labels.astype(np.float16), figures


def taught(args):
    """Whether the student knows something before the first round."""
    return args.start or args.answers


class Run:
    """Everything that a checkpoint holds, and how it is carried on."""

    def __init__(self, motion, out, args):
        self.motion, self.out, self.args = motion, Path(out), args
        torch.manual_seed(args.seed)
        self.student, self.mirror = Mlp(), Mirror()
        if args.start:
            self.student.load_state_dict(checkpoint.load(args.start)["student"])
        self.average = Average(self.student)
        self.optimizer = MuonAdamW(self.student.named_parameters(), args.lr, weight_decay=0.0,
                                   split=(), plain=(LAST,))
        self.round, self.samples, self.batches, self.seconds = 0, 0, 0, 0.0
        self.memory = Memory(args.keep)
        # Rounds are played while the one before is learnt from, with the weights before that.
        self.driver = self.weights()

    def weights(self):
        """A copy of the averaged ones: they drive, and are what is evaluated and exported."""
        return {key: value.clone() for key, value in self.average.weights.items()}

    def save(self):
        """Weights, optimiser and counters; the data lies beside, one file a round."""
        state = {"student": self.average.weights, "raw": self.student.state_dict(),
                 "driver": self.driver, "optimizer": self.optimizer.state_dict(),
                 "round": self.round, "samples": self.samples, "batches": self.batches,
                 "seconds": self.seconds}
        checkpoint.save(self.out / "state.pt", state)

    def restore(self):
        """Goes on where the run in `out` stopped; begins where there is none."""
        if self.args.answers:
            for path in sorted(Path(self.args.answers).glob("round-*.npz"))[-self.args.keep:]:
                self.remember(path)
        if not (self.out / "state.pt").exists():
            if self.args.answers:
                self.student.normalise_by(torch.cat(self.memory.inputs[::5]).float())
                self.average = Average(self.student)
                self.learn(self.args.first)
                self.driver = self.weights()
                self.save()
            return
        state = checkpoint.load(self.out / "state.pt")
        self.student.load_state_dict(state["raw"])
        self.average.weights, self.driver = state["student"], state["driver"]
        self.optimizer.load_state_dict(state["optimizer"])
        self.round, self.samples = state["round"], state["samples"]
        self.batches, self.seconds = state["batches"], state["seconds"]
        for number in range(max(0, self.round - self.args.keep), self.round):
            self.remember(self.shard(number))

    def remember(self, path):
        with np.load(path) as data:
            self.memory.add(data["inputs"], data["labels"])

    def shard(self, number):
        return self.out / f"round-{number:05}.npz"

    def learn(self, batches):
        """Mean error of so many steps on answers that are remembered."""
        args = self.args
        generator = torch.Generator().manual_seed(args.seed * 100_003 + self.round)
        left = (args.rounds - self.round) / args.decay if args.rounds and args.decay else 1.0
        for group in self.optimizer.param_groups:
            group["lr"] = args.lr * max(0.02, min(1.0, left))
        total = 0.0
        for _ in range(batches):
            inputs, labels = self.memory.pick(args.batch, generator)
            half = args.batch // 2
            inputs[:half] = self.mirror.observation(inputs[:half])
            labels[:half] = self.mirror.action(labels[:half])
            with torch.autocast("cpu", torch.bfloat16, enabled=args.bfloat16):
                answers = self.student(inputs)
            error = (answers.float() - labels).square().mean()
            self.optimizer.zero_grad(set_to_none=True)
            error.backward()
            torch.nn.utils.clip_grad_norm_(self.student.parameters(), 1.0)
            self.optimizer.step()
            self.average.follow(self.batches)
            self.batches += 1
            total += error.item()
        return total / batches

    def go(self):
        """Rounds until told to stop."""
        with Beside(Player, self.motion, self.args) as player:
            played = player.play(self.round, self.driver)
            while self.args.rounds is None or self.round < self.args.rounds:
                began = time.perf_counter()
                inputs, labels, figures = played.result()
                self.driver = self.weights()
                played = player.play(self.round + 1, self.driver)
                np.savez(self.shard(self.round), inputs=inputs, labels=labels)
                self.memory.add(inputs, labels)
                if self.round < self.args.settle and not taught(self.args):
                    self.student.normalise_by(torch.cat(self.memory.inputs).float())
                error = self.learn(self.args.batches)
                self.round += 1
                self.samples += len(inputs) // 2
                self.seconds += time.perf_counter() - began
                line = {"round": self.round, "states": self.samples, "error": error, **figures,
                        "hours": self.seconds / 3600}
                self.save()
                record(self.out / "curve.jsonl", line)
            played.cancel()


def parser():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--motion", required=True, help="file of questsim.prepare")
    parser.add_argument("--out", required=True)
    parser.add_argument("--start", help="weights to begin with: another run's state.pt")
    parser.add_argument("--answers", help="folder of another run whose answers are learnt first")
    parser.add_argument("--first", type=int, default=2000, help="batches of these")
    parser.add_argument("--rounds", type=int, help="stop after so many in all")
    parser.add_argument("--worlds", type=int, default=96)
    parser.add_argument("--steps", type=int, default=72)
    parser.add_argument("--batches", type=int, default=60)
    parser.add_argument("--batch", type=int, default=2048)
    parser.add_argument("--bfloat16", action="store_true",
                        help="half the numbers' width: for processors with instructions for it")
    parser.add_argument("--keep", type=int, default=100, help="rounds that are remembered")
    parser.add_argument("--settle", type=int, default=5, help="rounds that set the normalisation")
    parser.add_argument("--share", type=float, default=0.8)
    parser.add_argument("--lr", type=float, default=3e-3)
    parser.add_argument("--decay", type=int, default=0,
                        help="rounds before --rounds in which the rate falls")
    parser.add_argument("--seed", type=int, default=0)
    practice_arguments(parser)
    return parser


def main(argv=None):
    args = parser().parse_args(argv)
    torch.set_num_threads(1)
    Path(args.out).mkdir(parents=True, exist_ok=True)
    run = Run(Motion.read(args.motion), args.out, args)
    run.restore()
    run.go()


if __name__ == "__main__":
    main()
