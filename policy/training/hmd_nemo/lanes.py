"""Endless training batches: each lane plays one clip after another, in chunks that join up.

A lane keeps its clip, its place in it and its augmentation between chunks, so the network's state
can run on: gradients reach back one chunk, memory as long as the motion lasts. Some clip changes
keep the state, which trains recovery from a wrong memory.

Two augmentations of the literature have no effect on these features and are left out: a turn
about the vertical (features live in the heading frame) and a uniform scale (lengths are in head
heights).
"""

from dataclasses import dataclass

import torch

from common.lanes import LaneState, clip_weights
from posed_mocap.rotations import rotvec_to_quat
from posed_mocap.skeleton import JOINTS, MIRROR, head_height

from .features import RATE
from .visibility import random_loss

SET_WEIGHTS = {
    "bandai": 0.34, "snu": 0.14, "fubot": 0.08, "cmu_amc2": 0.19, "cmu_amc": 0.03,
    "cmu_bvh": 0.06, "cmu_cc": 0.03, "cmu_expmap": 0.05, "cmu_poser": 0.05, "reactidle": 0.03,
}
STRONG = {"bandai": 0.3, "snu": 0.3, "fubot": 0.5}
"""Share of lanes with body and sensor-frame augmentation; 0.7 where a set is not named."""
STRONG_DEFAULT = 0.7
CONTROLLERS, FIELD_OF_VIEW, HEAD_ONLY = 0, 1, 2
SCENARIO_WEIGHTS = torch.tensor([0.56, 0.40, 0.04])
SPLICE = 0.3
VISIT = 8
"""Chunks after which a lane leaves a clip."""
LEGS = [1, 2, 4, 5, 7, 8, 10, 11]
TORSO = [3, 6, 9, 12, 13, 14]
GROUPS = [LEGS, TORSO, [15], [16, 17], [18, 19], [20, 21]]


@dataclass
class Chunk:
    """One batch: frame 0 of the motion only serves the velocities of frame 1."""

    quats: torch.Tensor
    """(B, T+1, 22, 4) local, the pelvis' in the world."""
    root: torch.Tensor
    offsets: torch.Tensor
    height: torch.Tensor
    sensor_turn: torch.Tensor
    """(B, 3, 4) fixed rotations of head, left and right hand sensor in their joint."""
    lost: torch.Tensor
    """(B, T+1, 2) bool, random loss of the hands."""
    scenario: torch.Tensor
    reset: torch.Tensor
    rate: float = RATE
    """Frames per second."""


def mirror(quats, root, offsets):
    """The motion seen in a mirror across x = 0, left and right exchanged."""
    flip_q = torch.tensor([1.0, -1.0, -1.0, 1.0])
    flip_p = torch.tensor([-1.0, 1.0, 1.0])
    return quats[..., MIRROR, :] * flip_q, root * flip_p, offsets[..., MIRROR, :] * flip_p


def play(store, clip, times):
    """Motion at fractional frames: Catmull-Rom on quaternions and root. times (B, n)."""
    base = times.floor().long()
    f = (times - base).float()
    weights = torch.stack([
        -0.5 * f + f**2 - 0.5 * f**3, 1 - 2.5 * f**2 + 1.5 * f**3,
        0.5 * f + 2 * f**2 - 1.5 * f**3, -0.5 * f**2 + 0.5 * f**3,
    ], -1)
    first, last = store.start[clip][:, None, None], store.start[clip + 1][:, None, None] - 1
    taps = base.unsqueeze(-1) + torch.arange(-1, 3)
    taps = torch.minimum(torch.maximum(taps + first, first), last)
    quats = (store.quats[taps].float() * weights[..., None, None]).sum(2)
    root = (store.root[taps] * weights[..., None]).sum(2)
    return quats / quats.norm(dim=-1, keepdim=True), root


class Lanes(LaneState):
    """`batch` lanes over a store; `next_chunk` advances all of them by `frames`.

    A `stride` above one skips source frames. Neighbouring frames at 60 Hz teach nearly the same,
    so the first part of a training sees more motion for its time at 20 or 30 Hz.
    """

    def __init__(self, store, batch, frames, seed, augment=True, stride=1, shares=SET_WEIGHTS):
        self.store, self.batch, self.frames, self.augment = store, batch, frames, augment
        self.stride, self.span = stride, frames * stride
        super().__init__(seed)
        length = (store.start[1:] - store.start[:-1]).double()
        self.weight = clip_weights(store.sources, length, length > 80, shares, self.span, VISIT)
        self.length = length
        self.lane = {
            "clip": torch.zeros(batch, dtype=torch.long),
            "place": torch.full((batch,), 1e9, dtype=torch.double),
            "visit": torch.zeros(batch, dtype=torch.long),
            "speed": torch.ones(batch, dtype=torch.double),
            "mirrored": torch.zeros(batch, dtype=torch.bool),
            "scenario": torch.zeros(batch, dtype=torch.long),
            "stretch": torch.ones(batch, len(GROUPS)),
            "turn": torch.zeros(batch, 3, 3),
            "height_error": torch.ones(batch),
            "floor_error": torch.zeros(batch),
            "lost": torch.zeros(batch, 2, dtype=torch.bool),
            "started": torch.zeros(batch, dtype=torch.bool),
        }

    def _renew(self, which):
        """Gives the lanes `which` (indices) a new clip, place and augmentation."""
        lane, n = self.lane, len(which)
        clip = self._draw(self.weight, n)
        lane["clip"][which] = clip
        lane["visit"][which] = 0
        fast = self._uniform(n) < 0.5
        speed = torch.where(fast, torch.exp(0.223 * (2 * self._uniform(n) - 1)), torch.ones(n))
        speed = speed.double() if self.augment else torch.ones(n).double()
        lane["speed"][which] = speed
        room = (self.length[clip] - 3 - speed * self.span).clamp_min(1)
        lane["place"][which] = torch.floor(self._uniform(n) * room)
        if not self.augment:
            return
        share = torch.tensor([STRONG.get(self.store.sources[c], STRONG_DEFAULT) for c in clip])
        strong = (self._uniform(n) < share).float()[:, None]
        lane["mirrored"][which] = self._uniform(n) < 0.5
        lane["stretch"][which] = torch.exp(0.05 * strong * self._normal(n, len(GROUPS)))
        spread = torch.tensor([[0.14, 0.05, 0.05], [0.12, 0.12, 0.12], [0.12, 0.12, 0.12]])
        lane["turn"][which] = self._normal(n, 3, 3) * spread * strong[:, None]
        lane["height_error"][which] = torch.exp(0.012 * strong[:, 0] * self._normal(n))
        lane["floor_error"][which] = 0.015 * strong[:, 0] * self._normal(n)
        lane["lost"][which] = False

    def _advance(self):
        """Renews ended lanes; returns which lanes (B, 1) start with a fresh state."""
        lane = self.lane
        need = lane["place"] + lane["speed"] * self.span + 2
        ended = (need >= self.length[lane["clip"]]) | (lane["visit"] >= VISIT)
        ended = ended.nonzero().squeeze(1)
        reset = torch.zeros(self.batch, dtype=torch.bool)
        if len(ended):
            self._renew(ended)
            fresh = ~lane["started"][ended] | (self._uniform(len(ended)) > SPLICE)
            reset[ended] = fresh
            drawn = torch.multinomial(SCENARIO_WEIGHTS, len(ended), replacement=True,
                                      generator=self.generator)
            lane["scenario"][ended] = drawn
            lane["started"][ended] = True
        return reset[:, None]

    def next_chunk(self):
        """The next `frames` frames of every lane."""
        lane = self.lane
        reset = self._advance()
        steps = self.stride * torch.arange(self.frames + 1, dtype=torch.double)
        times = lane["place"][:, None] + lane["speed"][:, None] * steps
        quats, root = play(self.store, lane["clip"], times)
        lane["visit"] += 1
        lane["place"] += lane["speed"] * self.span
        offsets, root = self._stretched(root)
        flipped = mirror(quats, root, offsets)
        chosen = lane["mirrored"]
        quats = torch.where(chosen[:, None, None, None], flipped[0], quats)
        root = torch.where(chosen[:, None, None], flipped[1], root)
        offsets = torch.where(chosen[:, None, None], flipped[2], offsets)
        height = head_height(offsets) * lane["height_error"]
        root = root + (lane["floor_error"] * height)[:, None, None] * torch.tensor([0.0, 1.0, 0.0])
        lost = random_loss(lane["lost"], self.frames + 1, self.generator)
        lane["lost"] = lost[:, -1]
        return Chunk(quats, root, offsets, height, rotvec_to_quat(lane["turn"]), lost,
                     lane["scenario"].clone(), reset, RATE / self.stride)

    def _stretched(self, root):
        """Bone offsets with changed proportions; the root path scales with the legs, so that
        feet that stand keep standing."""
        factor = torch.ones(self.batch, JOINTS)
        for i, joints in enumerate(GROUPS):
            factor[:, joints] = self.lane["stretch"][:, i : i + 1]
        offsets = self.store.offsets[self.lane["clip"]] * factor.unsqueeze(-1)
        return offsets, root * self.lane["stretch"][:, 0, None, None]

