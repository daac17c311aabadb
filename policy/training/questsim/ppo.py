"""Stage (d): the student trained on with reward (4) by PPO, the paper's constants (appendix A).

An iteration plays fresh episodes and depends on the weights before it and on its number alone:
killed and started again, the curve is the same.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import torch

from common import checkpoint
from common.log import record

from .dagger import LOOKAHEADS
from .motion import Motion
from .student import Mlp
from .worlds import WEIGHTS, Options, Worlds

CLIP, GAMMA, LAMBDA = 0.2, 0.97, 0.95
SPREAD = 0.03
"""Of the exploration, in actions of -1 to 1."""
EPOCHS, MINIBATCHES = 5, 4


def advantages(rewards, values, ended, last):
    """GAE over (steps, worlds); `ended` marks steps after which nothing is to come."""
    out, carry = np.zeros_like(rewards), np.zeros_like(last)
    following = last
    for step in reversed(range(len(rewards))):
        going = 1.0 - ended[step]
        surprise = rewards[step] + GAMMA * following * going - values[step]
        carry = surprise + GAMMA * LAMBDA * going * carry
        out[step], following = carry, values[step]
    return out


class Run:
    """Actor, critic, optimiser and counters."""

    def __init__(self, motion, out, args):
        self.motion, self.out, self.args = motion, Path(out), args
        torch.manual_seed(args.seed)
        self.actor, self.critic = Mlp(), Mlp(1)
        start = checkpoint.load(args.start)["student"]
        self.actor.load_state_dict(start)
        self.critic.mean.copy_(self.actor.mean)
        self.critic.scale.copy_(self.actor.scale)
        every = [*self.actor.parameters(), *self.critic.parameters()]
        self.optimizer = torch.optim.Adam(every, args.lr)
        self.iteration, self.steps, self.seconds = 0, 0, 0.0

    def state(self):
        return {"student": self.actor.state_dict(), "critic": self.critic.state_dict(),
                "optimizer": self.optimizer.state_dict(), "iteration": self.iteration,
                "steps": self.steps, "seconds": self.seconds}

    def save(self):
        checkpoint.save(self.out / "state.pt", self.state())

    def restore(self):
        if not (self.out / "state.pt").exists():
            return
        state = checkpoint.load(self.out / "state.pt")
        self.actor.load_state_dict(state["student"])
        self.critic.load_state_dict(state["critic"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.iteration, self.steps = state["iteration"], state["steps"]
        self.seconds = state["seconds"]

    @torch.no_grad()
    def play(self):
        args = self.args
        rng = np.random.default_rng((args.seed, self.iteration))
        worlds = Worlds(self.motion, args.worlds, (args.seed, self.iteration, 1),
                        Options(lookaheads=LOOKAHEADS, headset_only=0.25))
        kept = {key: [] for key in ("seen", "action", "reward", "value", "ended")}
        falls, terms_sum = 0, []
        for _ in range(args.steps):
            seen = torch.from_numpy(worlds.observe().astype(np.float32))
            mean = self.actor(seen).numpy()
            action = mean + rng.normal(0, SPREAD, mean.shape)
            terms, lost, over = worlds.step(action)
            value = self.critic(seen)[:, 0].numpy()
            reward = terms @ WEIGHTS
            again = np.flatnonzero(lost | over)
            if len(again):
                after = self.critic(torch.from_numpy(worlds.observe().astype(np.float32)))
                # The time that an episode may take is no fault of the policy's.
                reward = reward + np.where(over & ~lost, GAMMA * after[:, 0].numpy(), 0)
                worlds.reset(again)
            for key, made in zip(kept, (seen.numpy(), action, reward, value, lost | over)):
                kept[key].append(np.asarray(made, np.float32))
            falls += int(lost.sum())
            terms_sum.append(terms.mean(0))
        last = self.critic(torch.from_numpy(worlds.observe().astype(np.float32)))[:, 0].numpy()
        kept = {key: np.stack(made) for key, made in kept.items()}
        gain = advantages(kept["reward"], kept["value"], kept["ended"], last)
        count = args.steps * args.worlds
        figures = {"falls_per_minute": falls / count * 36 * 60,
                   "terms": np.mean(terms_sum, 0).round(3).tolist()}
        return kept, gain, figures

    def learn(self, kept, gain):
        flat = {key: torch.from_numpy(kept[key].reshape(-1, *kept[key].shape[2:]))
                for key in ("seen", "action", "value")}
        gain = torch.from_numpy(gain.reshape(-1))
        target = gain + flat["value"]
        gain = (gain - gain.mean()) / (gain.std() + 1e-6)
        with torch.no_grad():
            before = self.log_chance(flat["seen"], flat["action"])
        generator = torch.Generator().manual_seed(self.args.seed * 100_003 + self.iteration)
        warm = self.iteration < self.args.critic_first
        for _ in range(EPOCHS):
            order = torch.randperm(len(gain), generator=generator)
            for pick in order.chunk(MINIBATCHES):
                loss = (self.critic(flat["seen"][pick])[:, 0] - target[pick]).square().mean()
                if not warm:
                    now = self.log_chance(flat["seen"][pick], flat["action"][pick])
                    ratio = (now - before[pick]).exp()
                    gains = torch.minimum(ratio * gain[pick],
                                          ratio.clamp(1 - CLIP, 1 + CLIP) * gain[pick])
                    loss = loss - gains.mean()
                self.optimizer.zero_grad(set_to_none=True)
                loss.backward()
                torch.nn.utils.clip_grad_norm_(self.actor.parameters(), 1.0)
                self.optimizer.step()

    def log_chance(self, seen, action):
        return -(action - self.actor(seen)).square().sum(1) / (2 * SPREAD**2)

    def go(self):
        while self.args.iterations is None or self.iteration < self.args.iterations:
            began = time.perf_counter()
            kept, gain, figures = self.play()
            self.learn(kept, gain)
            self.iteration += 1
            self.steps += gain.size
            self.seconds += time.perf_counter() - began
            line = {"iteration": self.iteration, "steps": self.steps, **figures,
                    "reward": float(np.dot(figures["terms"], WEIGHTS)),
                    "hours": self.seconds / 3600}
            self.save()
            record(self.out / "curve.jsonl", line)


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--motion", required=True, help="file of questsim.prepare")
    parser.add_argument("--start", required=True, help="state.pt of questsim.dagger")
    parser.add_argument("--out", required=True)
    parser.add_argument("--iterations", type=int, help="stop after so many in all")
    parser.add_argument("--worlds", type=int, default=128)
    parser.add_argument("--steps", type=int, default=60)
    parser.add_argument("--lr", type=float, default=1e-4)
    parser.add_argument("--critic-first", type=int, default=5,
                        help="iterations that teach the critic alone")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args(argv)
    torch.set_num_threads(1)
    Path(args.out).mkdir(parents=True, exist_ok=True)
    run = Run(Motion.read(args.motion), args.out, args)
    run.restore()
    run.go()


if __name__ == "__main__":
    main()
