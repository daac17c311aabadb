"""Trains PIP's networks on the shared motion capture.

    python -m pip.train --mocap DIR --out RUN --model small

The learning rate warms up, stays, and decays only over the last `--decay` steps before `--steps`
or the last `--until-decay` seconds before `--until`: a run whose end is not known yet is stopped at any time and
finished later. Started again with the same `--out` it goes on where it stopped.
"""

import argparse
import signal
import time
from dataclasses import asdict
from pathlib import Path

import torch

from common import checkpoint, schedule
from common.average import Average
from common.lanes import shares_of
from common.log import Log
from common.optimizer import MuonAdamW
from posed_mocap import store as stores

from . import motion
from .checkpoint import build_model
from .evaluate import table
from .lanes import SET_WEIGHTS, Lanes
from .losses import losses, total
from .model import select

VALIDATION_SETS = ["bandai", "cmu_amc", "cmu_amc2", "cmu_bvh", "cmu_cc"]
SPLIT = ("lstm.weight",)
"""Layers whose outputs are an LSTM's four gates side by side: each is its own matrix."""
PLAIN = ("enter", "leave", "begin_", "bias")
"""Inputs, outputs, vectors: AdamW."""


def arguments():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mocap", required=True, help="folder of the shared .npz sets")
    parser.add_argument("--sets", default=",".join(stores.TRAIN_SETS))
    parser.add_argument("--cache", default=stores.default_cache())
    parser.add_argument("--shares", help="SET=SHARE,... of the lanes' time, beside the usual ones")
    parser.add_argument("--out", required=True, help="folder of checkpoints and logs")
    parser.add_argument("--start", help="checkpoint to begin from where --out has none")
    parser.add_argument("--model", default="small")
    parser.add_argument("--no-initial", action="store_true",
                        help="ablation: the memory of P_L and V_A begins at zero")
    parser.add_argument("--only", help="train these networks alone, comma-separated")
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--stride", type=int, default=1, help="60 Hz frames per step of the motion")
    schedule.add_arguments(parser, rate=2e-3, warmup=100)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--validate-every", type=int, default=200)
    parser.add_argument("--save-seconds", type=float, default=180)
    return parser.parse_args()


class Run:
    """Everything a training step needs, and what a checkpoint keeps."""

    def __init__(self, args):
        self.args = args
        args.begun = 0
        torch.manual_seed(args.seed)
        torch.set_float32_matmul_precision("medium")
        motions = motion.cached(args.mocap, args.cache, args.sets.split(","), ["train"])
        shares = shares_of(args.shares, SET_WEIGHTS)
        self.lanes = Lanes(
            motions, args.batch, args.frames, args.seed, args.stride, shares=shares)
        self.model = build_model(args.model)
        if args.no_initial:
            config = {**asdict(self.model.config), "initial": False}
            self.model = build_model(config)
        self.average = Average(self.model)
        named = [(n, p) for n, p in self.model.named_parameters() if self._trains(n)]
        for name, parameter in self.model.named_parameters():
            parameter.requires_grad_(self._trains(name))
        self.parameters = [p for _, p in named]
        self.optimizer = MuonAdamW(named, args.rate, split=SPLIT, split_blocks=4, plain=PLAIN)
        self.state = self.model.initial_state(args.batch)
        self.step, self.seconds, self.best = 0, 0.0, float("inf")

    def _trains(self, name):
        part = name.split(".")[0].removeprefix("begin_")
        return not self.args.only or part in self.args.only.split(",")

    def state_dict(self):
        return {
            "config": asdict(self.model.config), "model": self.model.state_dict(),
            "average": self.average.weights, "optimizer": self.optimizer.state_dict(), "step": self.step,
            "seconds": self.seconds, "best": self.best, "lanes": self.lanes.state_dict(),
            "state": {n: list(p) for n, p in self.state.items()},
            "arguments": {k: str(v) for k, v in vars(self.args).items()},
        }

    def load_state_dict(self, state):
        mine = self.model.state_dict()
        keep = {k: v.float() for k, v in state["average"].items() if k in mine}
        self.average.weights = {**self.average.weights, **keep}
        self.model.load_state_dict(
            {**mine, **{k: v.float() for k, v in state.get("model", keep).items() if k in mine}})
        self.step, self.seconds, self.best = state["step"], state["seconds"], state["best"]
        if "optimizer" in state and not self.args.only and not self.args.no_initial:
            self.optimizer.load_state_dict(state["optimizer"])
        same_stride = state["arguments"]["stride"] == str(self.args.stride)
        if not same_stride:
            self.best = float("inf")
        same = "lanes" in state and len(state["lanes"]["lane"]["clip"]) == self.lanes.batch
        if same and same_stride:
            self.lanes.load_state_dict(state["lanes"])
            self.state = {n: tuple(p) for n, p in state["state"].items()}

    def train_step(self):
        """One chunk of every lane; returns the losses as floats."""
        batch = self.lanes.next_batch()
        fresh = self.model.begin(
            batch.first_leaves + 0.015 * torch.randn_like(batch.first_leaves),
            batch.first_velocities + 0.05 * torch.randn_like(batch.first_velocities))
        out, self.state = self.model(batch.features, select(batch.reset, fresh, self.state))
        named = losses(out, batch)
        loss = total(named)
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(self.parameters, 1.0)
        if not torch.isfinite(norm):
            raise FloatingPointError(f"gradient is not finite at step {self.step}")
        for group in self.optimizer.param_groups:
            group["lr"] = schedule.learning_rate(self.args, self.step)
        self.optimizer.step()
        self.average.follow(self.step)
        self.step += 1
        return {"loss": loss.item(), "grad": norm.item(), **{k: v.item() for k, v in named.items()}}

    def validate(self, motions):
        """Validation table of the averaged weights."""
        stride = self.args.stride
        return self.average.measure(
            lambda model: dict(table(model, motions, per_set=24, stride=stride)))


def score(result):
    """What picks the best checkpoint: SIP error and the way's error, mean over sets."""
    return sum(r["sip_deg"] + 0.2 * r["way_cm_s"] for r in result.values()) / len(result)


def train(args):
    torch.set_num_threads(1)
    out = Path(args.out)
    out.mkdir(parents=True, exist_ok=True)
    run, log = Run(args), Log(out, ("sip_deg", "joint_cm", "way_cm_s", "contact"))
    last = out / "last.pt"
    source = last if last.exists() else args.start
    if source:
        run.load_state_dict(checkpoint.load(source))
        print(f"going on from step {run.step}", flush=True)
    if not last.exists():
        args.begun, run.best = run.step, float("inf")
    validation = motion.cached(args.mocap, args.cache, VALIDATION_SETS, ["val"])
    stopped = []
    signal.signal(signal.SIGTERM, lambda *_: stopped.append(True))
    begun, before, saved = time.monotonic(), run.seconds, time.monotonic()
    while run.step < args.steps and not stopped:
        named = run.train_step()
        run.seconds = before + time.monotonic() - begun
        log.losses(run, named)
        ended = schedule.ended(args, run.step)
        if run.step % args.validate_every == 0 or ended:
            result = run.validate(validation)
            value = score(result)
            log.validation(run, value, result)
            if value < run.best:
                run.best = value
                checkpoint.save(out / "best.pt", run.state_dict())
        if time.monotonic() - saved > args.save_seconds:
            checkpoint.save(last, run.state_dict())
            saved = time.monotonic()
        if ended:
            break
    checkpoint.save(last, run.state_dict())


if __name__ == "__main__":
    train(arguments())
