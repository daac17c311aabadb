"""Stage (d): the student trained on with reward (4) by PPO, the paper's constants (appendix A).

Episodes go on from one iteration to the next; the checkpoint holds the worlds too: killed and started
again, the curve is the same.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import torch

from common import checkpoint
from common.average import Average
from common.beside import Beside
from common.log import cut, record

from .mirror import Mirror
from .motion import Motion
from .student import Mlp
from .worlds import WEIGHTS, Worlds, practice, practice_arguments

CLIP, GAMMA, LAMBDA = 0.2, 0.97, 0.95
SPREAD = 0.03
"""Of the exploration, in actions of -1 to 1."""
EPOCHS, MINIBATCHES = 5, 4
CRITIC_LR = 3e-4
FARTHEST = 4.0
"""An iteration teaches the actor no more once it is so many times as far away as it shall go."""


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


class Player:
    """Plays an iteration's steps; lives in a process of its own, so that playing and learning share
    two cores."""

    def __init__(self, motion, args, kept):
        self.args, self.actor, self.critic, self.mirror = args, Mlp(), Mlp(1), Mirror()
        self.worlds = Worlds(motion, args.worlds, args.seed, practice(args, lost=args.lost))
        # Every other world is seen and driven mirrored: both sides learn from either.
        self.flipped = torch.arange(args.worlds) % 2 == 1
        if kept:
            self.worlds.restore(kept)

    def see(self):
        seen = torch.from_numpy(self.worlds.observe().astype(np.float32))
        return torch.where(self.flipped[:, None], self.mirror.observation(seen), seen)

    @torch.no_grad()
    def play(self, number, actor, critic):
        """What was seen and done, arrays (steps, worlds, ...); figures; the worlds afterwards."""
        args, worlds = self.args, self.worlds
        self.actor.load_state_dict(actor)
        self.critic.load_state_dict(critic)
        rng = np.random.default_rng((args.seed, number))
        kept = {key: [] for key in ("seen", "mean", "action", "reward", "value", "ended")}
        falls, terms_sum = 0, []
        seen = self.see()
        for _ in range(args.steps):
            mean = self.actor(seen)
            action = mean + torch.from_numpy(rng.normal(0, SPREAD, mean.shape)).float()
            done = torch.where(self.flipped[:, None], self.mirror.action(action), action)
            terms, lost, over = worlds.step(done.numpy())
            value = self.critic(seen)[:, 0].numpy()
            reward = terms @ WEIGHTS
            again = np.flatnonzero(lost | over)
            following = self.see()
            if len(again):
                # The time that an episode may take is no fault of the policy's.
                after = self.critic(following)[:, 0].numpy()
                reward = reward + np.where(over & ~lost, GAMMA * after, 0)
                worlds.reset(again)
                following = self.see()
            made = (seen.numpy(), mean.numpy(), action.numpy(), reward, value, lost | over)
            for key, array in zip(kept, made):
                kept[key].append(np.asarray(array, np.float32))
            seen = following
            falls += int(lost.sum())
            terms_sum.append(terms.mean(0))
        last = self.critic(seen)[:, 0].numpy()
        kept = {key: np.stack(made) for key, made in kept.items()}
        gain = advantages(kept["reward"], kept["value"], kept["ended"], last)
        figures = {"falls_per_minute": falls / (args.steps * args.worlds) * 36 * 60,
                   "terms": np.mean(terms_sum, 0).round(3).tolist()}
        return kept, gain, figures, worlds.snapshot()


class Run:
    """Actor, critic, optimiser, counters and the worlds."""

    def __init__(self, motion, out, args):
        self.motion, self.out, self.args = motion, Path(out), args
        torch.manual_seed(args.seed)
        self.actor, self.critic = Mlp(), Mlp(1)
        start = checkpoint.load(args.start)
        self.actor.load_state_dict(start["student"])
        self.critic.mean.copy_(self.actor.mean)
        self.critic.scale.copy_(self.actor.scale)
        if "critic" in start:
            self.critic.load_state_dict(start["critic"])
        self.average = Average(self.actor)
        self.optimizer = torch.optim.Adam([
            {"params": self.actor.parameters(), "lr": args.lr / 10},
            {"params": self.critic.parameters(), "lr": CRITIC_LR}])
        self.iteration, self.steps, self.updates, self.seconds = 0, 0, 0, 0.0
        self.worlds = None
        # An iteration is played while the one before is learnt from, with the weights before that.
        self.drivers = self.weights()

    def weights(self):
        """Copies of the actor's and the critic's."""
        return [{key: value.clone() for key, value in network.state_dict().items()}
                for network in (self.actor, self.critic)]

    def save(self):
        worlds = {key: torch.from_numpy(value) if isinstance(value, np.ndarray) else value
                  for key, value in self.worlds.items()}
        checkpoint.save(self.out / "state.pt", {
            "worlds": worlds, "student": self.average.weights, "raw": self.actor.state_dict(),
            "critic": self.critic.state_dict(), "drivers": self.drivers,
            "optimizer": self.optimizer.state_dict(), "iteration": self.iteration,
            "steps": self.steps, "updates": self.updates, "seconds": self.seconds})

    def restore(self):
        if not (self.out / "state.pt").exists():
            return
        state = checkpoint.load(self.out / "state.pt")
        self.actor.load_state_dict(state["raw"])
        self.critic.load_state_dict(state["critic"])
        self.average.weights, self.drivers = state["student"], state["drivers"]
        self.optimizer.load_state_dict(state["optimizer"])
        self.iteration, self.steps = state["iteration"], state["steps"]
        self.updates, self.seconds = state["updates"], state["seconds"]
        self.worlds = {key: value.numpy() if isinstance(value, torch.Tensor) else value
                       for key, value in state["worlds"].items()}
        cut(self.out / "curve.jsonl", "iteration", self.iteration)

    def learn(self, kept, gain):
        """The mean divergence of the last epoch's policy from the one that played."""
        flat = {key: torch.from_numpy(kept[key].reshape(-1, *kept[key].shape[2:]))
                for key in ("seen", "mean", "action", "value")}
        gain = torch.from_numpy(gain.reshape(-1))
        target = gain + flat["value"]
        gain = (gain - gain.mean()) / (gain.std() + 1e-6)
        before = log_chance(flat["action"], flat["mean"])
        generator = torch.Generator().manual_seed(self.args.seed * 100_003 + self.iteration)
        warm = self.iteration < self.args.critic_first
        apart = []
        for _ in range(EPOCHS):
            order = torch.randperm(len(gain), generator=generator)
            for pick in order.chunk(MINIBATCHES):
                loss = (self.critic(flat["seen"][pick])[:, 0] - target[pick]).square().mean()
                if not warm and (not apart or apart[-1] < FARTHEST * self.args.apart):
                    mean = self.actor(flat["seen"][pick])
                    ratio = (log_chance(flat["action"][pick], mean) - before[pick]).exp()
                    gains = torch.minimum(ratio * gain[pick],
                                          ratio.clamp(1 - CLIP, 1 + CLIP) * gain[pick])
                    loss = loss - gains.mean()
                    apart.append(divergence(mean.detach(), flat["mean"][pick]))
                self.optimizer.zero_grad(set_to_none=True)
                loss.backward()
                torch.nn.utils.clip_grad_norm_(self.actor.parameters(), 1.0)
                self.optimizer.step()
                self.average.follow(self.updates)
                self.updates += 1
        found = float(np.mean(apart[-MINIBATCHES:])) if apart else 0.0
        self.adapt(found)
        return found

    def adapt(self, apart):
        """Sets the actor's rate so that the next iteration keeps to the divergence wanted."""
        group = self.optimizer.param_groups[0]
        if apart > 2 * self.args.apart:
            group["lr"] = max(group["lr"] / 1.3, self.args.lr / 1000)
        elif 0 < apart < self.args.apart / 2:
            group["lr"] = min(group["lr"] * 1.3, self.args.lr)

    def go(self):
        """Iterations until told to stop."""
        with Beside(Player, self.motion, self.args, self.worlds) as player:
            played = player.play(self.iteration, *self.drivers)
            while self.args.iterations is None or self.iteration < self.args.iterations:
                began = time.perf_counter()
                kept, gain, figures, self.worlds = played.result()
                self.drivers = self.weights()
                waited = time.perf_counter() - began
                played = player.play(self.iteration + 1, *self.drivers)
                apart = self.learn(kept, gain)
                self.iteration += 1
                self.steps += gain.size
                self.seconds += time.perf_counter() - began
                line = {"iteration": self.iteration, "steps": self.steps, **figures,
                        "reward": float(np.dot(figures["terms"], WEIGHTS)), "divergence": apart,
                        "rate": self.optimizer.param_groups[0]["lr"],
                        "waited_s": waited, "hours": self.seconds / 3600}
                if self.iteration % self.args.save_every == 0 \
                        or self.iteration == self.args.iterations:
                    self.save()
                record(self.out / "curve.jsonl", line)
            played.cancel()


def log_chance(action, mean):
    return -(action - mean).square().sum(1) / (2 * SPREAD**2)


def divergence(mean, before):
    """Of two policies with the same spread, nats."""
    return float((mean - before).square().sum(1).mean() / (2 * SPREAD**2))


def main(argv=None):
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--motion", required=True, help="file of questsim.prepare")
    parser.add_argument("--start", required=True,
                        help="state.pt of questsim.dagger, or of PPO on other motion")
    parser.add_argument("--out", required=True)
    parser.add_argument("--iterations", type=int, help="stop after so many in all")
    parser.add_argument("--worlds", type=int, default=256)
    parser.add_argument("--steps", type=int, default=32)
    practice_arguments(parser)
    parser.add_argument("--lost", type=float, default=0.4,
                        help="episodes end when pelvis or head are so far off, metres")
    parser.add_argument("--save-every", type=int, default=10, help="iterations")
    parser.add_argument("--lr", type=float, default=1e-4)
    parser.add_argument("--apart", type=float, default=0.05,
                        help="divergence (nats) of an iteration's last policy from the one that "
                             "played, which the actor's rate is set to keep to")
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
