"""Trains HMD-NeMo, or the AvatarPoser baseline, on the shared motion capture.

    python -m hmd_nemo.train --mocap DIR --out RUN --model small

The learning rate warms up, stays, and decays only over the last `--decay` steps before
`--steps`, or the last `--until-decay` seconds before `--until`: a run whose end is not known yet
is stopped at any time and finished later. Started again with the same `--out` it goes on where it stopped.
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

from .checkpoint import build_model
from .evaluate import table
from .lanes import SET_WEIGHTS, Lanes
from .losses import losses, total
from .sample import Sample, build
from .workers import Workers, spawn

VALIDATION_SETS = ["bandai", "cmu_amc", "cmu_amc2", "cmu_bvh", "cmu_cc"]


def arguments():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mocap", help="folder of the shared .npz sets")
    parser.add_argument("--store", help="one training file made by hmd_nemo.pack, instead")
    parser.add_argument("--validation", help="one validation file made by hmd_nemo.pack")
    parser.add_argument("--sets", default=",".join(stores.TRAIN_SETS))
    parser.add_argument("--shares", help="SET=SHARE,... of the lanes' time, beside the usual ones")
    parser.add_argument("--cache", default=stores.default_cache())
    parser.add_argument("--out", required=True, help="folder of checkpoints and logs")
    parser.add_argument("--start", help="checkpoint to begin from where --out has none")
    parser.add_argument("--fresh-optimizer", action="store_true", help="forget its moments")
    parser.add_argument("--family", default="hmd_nemo")
    parser.add_argument("--model", default="small")
    parser.add_argument("--fixed-mask", action="store_true", help="ablation without TAMT")
    parser.add_argument("--batch", type=int, default=64)
    parser.add_argument("--frames", type=int, default=40)
    parser.add_argument("--stride", type=int, default=1, help="60 Hz frames per step of the motion")
    schedule.add_arguments(parser, rate=1e-3, warmup=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=1,
                        help="processes that share each batch; on busy CPUs better than threads")
    parser.add_argument("--threads", type=int, default=1, help="of each worker")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--validate-every", type=int, default=400)
    parser.add_argument("--save-seconds", type=float, default=180)
    return parser.parse_args()


def to_device(sample, device):
    return Sample(**{
        name: value.to(device) if torch.is_tensor(value) else value
        for name, value in vars(sample).items()
    })


class Run:
    """Everything a training step needs, and what a checkpoint keeps."""

    def __init__(self, args, workers):
        self.args, self.workers = args, workers
        args.begun = 0
        torch.manual_seed(args.seed)
        chosen = "cuda" if torch.cuda.is_available() else "cpu"
        self.device = torch.device(chosen if args.device == "auto" else args.device)
        # On a CPU "medium" lets oneDNN do the products: 2.4 times as fast here, with errors of
        # float32 size. On a GPU "high" means TF32.
        on_cpu = self.device.type == "cpu"
        torch.set_float32_matmul_precision("medium" if on_cpu else "high")
        if args.store:
            store = stores.load(args.store)
        else:
            store = stores.cached(args.mocap, args.cache, args.sets.split(","), ["train"])
        share = args.batch // workers.count
        self.lanes = Lanes(store, share, args.frames, args.seed * 1000 + workers.rank,
                           stride=args.stride, shares=shares_of(args.shares, SET_WEIGHTS))
        model = build_model(args.family, args.model)
        if args.fixed_mask:
            config = {**asdict(model.config), "tamt": False}
            model = build_model(args.family, config)
        self.model = model.to(self.device).train()
        self.average = Average(self.model)
        self.optimizer = MuonAdamW(self.model.named_parameters(), args.rate)
        self.state = self.model.initial_state(share)
        self.step, self.seconds, self.best = 0, 0.0, float("inf")

    def state_dict(self):
        return {
            "family": self.args.family, "config": asdict(self.model.config),
            "model": self.model.state_dict(), "average": self.average.weights,
            "optimizer": self.optimizer.state_dict(), "step": self.step, "seconds": self.seconds,
            "best": self.best, "random": torch.get_rng_state(), "arguments": {
                k: str(v) for k, v in vars(self.args).items()
            },
        }

    def load_state_dict(self, state):
        average = {k: v.to(self.device).float() for k, v in state["average"].items()}
        self.average.weights = average
        self.model.load_state_dict(state.get("model", average))
        self.step, self.seconds, self.best = state["step"], state["seconds"], state["best"]
        if "optimizer" in state and not self.args.fresh_optimizer:
            self.optimizer.load_state_dict(state["optimizer"])
            torch.set_rng_state(state["random"])

    def lanes_dict(self):
        """Where this worker's lanes are, and the network's memory of them."""
        return {"lanes": self.lanes.state_dict(), "state": list(self.state.tensors())}

    def load_lanes(self, state):
        """Goes on with saved lanes; of another batch size, starts fresh ones."""
        if len(state["lanes"]["lane"]["clip"]) == self.lanes.batch:
            self.lanes.load_state_dict(state["lanes"])
            self.state = type(self.state)(*(t.to(self.device) for t in state["state"]))

    def train_step(self):
        """One chunk of every lane; returns the losses as floats."""
        chunk = self.lanes.next_chunk()
        sample = to_device(build(chunk), self.device)
        reset = chunk.reset.to(self.device)
        out, state = self.model(sample.features, sample.visible, self.state, reset)
        named, error = losses(out, sample)
        loss = total(named)
        self.optimizer.zero_grad(set_to_none=True)
        loss.backward()
        self.workers.share_gradients(self.model.parameters())
        norm = torch.nn.utils.clip_grad_norm_(self.model.parameters(), 1.0)
        if not torch.isfinite(norm):
            raise FloatingPointError(f"gradient is not finite at step {self.step}")
        for group in self.optimizer.param_groups:
            group["lr"] = schedule.learning_rate(self.args, self.step)
        self.optimizer.step()
        self.state = state.detach()
        self.average.follow(self.step)
        self.step += 1
        return {"loss": loss.item(), "grad": norm.item(), **{k: v.item() for k, v in named.items()}}

    def validate(self, store):
        """Validation table of the averaged weights."""
        return self.average.measure(lambda model: dict(table(model, store, per_set=40)))


def score(result):
    """What picks the best checkpoint: MPJPE plus a tenth of MPJVE, mean over sets and scenarios."""
    return sum(r["mpjpe_cm"] + 0.1 * r["mpjve_cm_s"] for r in result.values()) / len(result)


def validation_store(args):
    if args.validation:
        return stores.load(args.validation)
    if args.mocap:
        return stores.cached(args.mocap, args.cache, VALIDATION_SETS, ["val"])
    return None


def save(run, out):
    """Every worker its lanes, the first the rest."""
    checkpoint.save(out / f"lanes.{run.workers.rank}.pt", run.lanes_dict())
    if run.workers.rank == 0:
        checkpoint.save(out / "last.pt", run.state_dict())


def resume(run, out):
    """Goes on from the folder's last checkpoint, or else begins from `--start`."""
    if not (out / "last.pt").exists() and run.args.start:
        run.load_state_dict(checkpoint.load(run.args.start))
        run.best = float("inf")
    if (out / "last.pt").exists():
        run.load_state_dict(checkpoint.load(out / "last.pt"))
        lanes = out / f"lanes.{run.workers.rank}.pt"
        if lanes.exists():
            run.load_lanes(checkpoint.load(lanes))
        print(f"going on from step {run.step}", flush=True)


def train(workers, args):
    """The loop of one worker."""
    torch.set_num_threads(args.threads)
    out, first = Path(args.out), workers.rank == 0
    out.mkdir(parents=True, exist_ok=True)
    run, log = Run(args, workers), Log(out, ("mpjpe_cm", "mpjve_cm_s"))
    resume(run, out)
    args.begun = run.step if args.fresh_optimizer or args.start else 0
    validation = validation_store(args) if first else None
    stopped = []
    signal.signal(signal.SIGTERM, lambda *_: stopped.append(True))
    begun, before, saved = time.monotonic(), run.seconds, time.monotonic()
    ended = run.step >= args.steps
    while not ended:
        named = run.train_step()
        run.seconds = before + time.monotonic() - begun
        (ended,) = workers.any_of(schedule.ended(args, run.step))
        due = run.step % args.validate_every == 0 or ended
        if first:
            log.losses(run, named)
        if validation and due:
            result = run.validate(validation)
            value = score(result)
            log.validation(run, value, result)
            if value < run.best:
                run.best = value
                checkpoint.save(out / "best.pt", run.state_dict())
        stop, keep = workers.any_of(bool(stopped), time.monotonic() - saved > args.save_seconds)
        if keep:
            save(run, out)
            saved = time.monotonic()
        if stop:
            break
    save(run, out)


def main():
    spawn(train, arguments())


if __name__ == "__main__":
    main()
