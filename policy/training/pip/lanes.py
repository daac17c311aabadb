"""Endless training batches: each lane plays one clip after another, in chunks that join up.

A lane keeps its clip, its place in it and its wearer between chunks, so the networks' state can
run on: gradients reach back one chunk, memory as long as the motion lasts. Some lanes stop for a
while, so that long stillness is learnt: nothing changes, and what was is still so.
"""

from dataclasses import dataclass

import torch

from common.lanes import LaneState, clip_weights
from posed_mocap.rotations import matrix_to_six, quat_to_matrix, rotvec_to_quat
from posed_mocap.skeleton import MIRROR

from .motion import RATE, SCALE
from .sensors import COUNT, JOINTS_OF, SensorError, features, measure, usual_place

SET_WEIGHTS = {
    "bandai": 0.30, "snu": 0.14, "fubot": 0.12, "cmu_amc2": 0.19, "cmu_amc": 0.03,
    "cmu_bvh": 0.06, "cmu_cc": 0.03, "cmu_expmap": 0.05, "cmu_poser": 0.05, "reactidle": 0.03,
    "sitting": 0.35,
}
LEAVES = [20, 21, 7, 8, 15]
"""Leaf joints: wrists, ankles, head."""
REDUCED = [1, 2, 3, 4, 5, 6, 9, 12, 13, 14, 15, 16, 17, 18, 19]
"""Joints whose rotation is predicted; feet and wrists are left straight."""
SPLICE = 0.3
VISIT = 12
"""Chunks after which a lane leaves a clip."""
VISIT_SITTING = 60
"""The same of people who sit (`posed_mocap.sitting`): it is for how long that matters."""
PAUSE = 0.04
"""Share of chunks after which a lane stops for a while."""
SMOOTHING = torch.tensor([4, 4, 4, 3, 2])
"""Frames to either side of a second difference: TransPose's 4, or less."""
MARGIN = 5


@dataclass
class Batch:
    """Inputs and targets of B lanes, T frames. Pelvis frame, lengths in head heights."""

    features: torch.Tensor
    leaves: torch.Tensor
    """(B, T, 15)"""
    joints: torch.Tensor
    """(B, T, 63) joints 1 to 21."""
    rotations: torch.Tensor
    """(B, T, 15, 6) of `REDUCED`."""
    velocities: torch.Tensor
    """(B, T, 66) head heights a second."""
    contact: torch.Tensor
    """(B, T, 2)"""
    first_leaves: torch.Tensor
    """(B, 15) at the frame before the first."""
    first_velocities: torch.Tensor
    """(B, 66)"""
    reset: torch.Tensor
    """(B,) bool: the memory is begun anew from the first pose."""
    span: torch.Tensor
    """(B,) seconds between frames."""


def targets(motions, index, before, after, seconds, height, mirrored=None):
    """What the networks should answer at frames `index` (B, T): leaves, joints, rotations,
    velocities. `seconds` (B,) from frame `before` to frame `after`."""
    places = motions.places[index]
    step = motions.places[after] - motions.places[before]
    step = step + (motions.root[after] - motions.root[before]).unsqueeze(2)
    turns = motions.turns[index].float() / SCALE
    if mirrored is not None:
        flip = torch.where(mirrored[:, None, None, None], torch.tensor([-1.0, 1.0, 1.0]), 1.0)
        swap = mirrored[:, None, None, None]
        places = torch.where(swap, places[:, :, MIRROR], places) * flip
        step = torch.where(swap, step[:, :, MIRROR], step) * flip
        mirror = torch.tensor([1.0, -1.0, -1.0, 1.0])
        turns = torch.where(swap, turns[:, :, MIRROR] * mirror, turns)
    matrix = quat_to_matrix(turns / turns.norm(dim=-1, keepdim=True))
    into_root = matrix[:, :, :1].mT
    scale = height[:, None, None, None]
    local = (into_root @ places.unsqueeze(-1)).squeeze(-1) / scale
    velocity = step / (seconds[:, None, None, None] * scale)
    velocity = (into_root @ velocity.unsqueeze(-1)).squeeze(-1)
    rotations = matrix_to_six(into_root @ matrix[:, :, REDUCED])
    return local[:, :, LEAVES].flatten(2), local[:, :, 1:].flatten(2), rotations, velocity.flatten(2)


class Lanes(LaneState):
    """`batch` lanes over motions; `next_batch` advances all of them by `frames`.

    A `stride` above one skips source frames: neighbouring frames at 60 Hz teach nearly the same.
    """

    def __init__(self, motions, batch, frames, seed, stride=1, augment=True, shares=SET_WEIGHTS):
        self.motions, self.batch, self.frames, self.augment = motions, batch, frames, augment
        self.stride, self.span = stride, frames * stride
        super().__init__(seed)
        length = (motions.start[1:] - motions.start[:-1]).double()
        usable = length > self.span + 3 * MARGIN
        self.visit = torch.tensor(
            [VISIT_SITTING if s == "sitting" else VISIT for s in motions.sources])
        self.weight = clip_weights(
            motions.sources, length, usable, shares, self.span, self.visit)
        self.length = length.long()
        self.place = usual_place(motions.offsets)
        b = batch
        self.lane = {
            "clip": torch.zeros(b, dtype=torch.long), "place": torch.full((b,), 1 << 40),
            "visit": torch.zeros(b, dtype=torch.long), "pause": torch.zeros(b, dtype=torch.long),
            "mirrored": torch.zeros(b, dtype=torch.bool), "tempo": torch.ones(b),
            "smoothing": torch.full((b,), 4), "arm": torch.zeros(b, COUNT, 3),
            "askew": torch.zeros(b, COUNT, 3), "bias": torch.zeros(b, COUNT, 3),
            "noise": torch.zeros(b), "drift": torch.zeros(b, COUNT),
            "drift_rate": torch.zeros(b, COUNT), "seen": torch.ones(b, COUNT, dtype=torch.bool),
            "height_error": torch.ones(b), "started": torch.zeros(b, dtype=torch.bool),
        }

    def _renew(self, which):
        """Gives the lanes `which` (indices) a new clip, place and wearer."""
        lane, n = self.lane, len(which)
        clip = self._draw(self.weight, n)
        lane["clip"][which] = clip
        lane["visit"][which] = 0
        lane["pause"][which] = 0
        room = (self.length[clip] - self.span - 2 * MARGIN).clamp_min(1)
        lane["place"][which] = MARGIN + (self._uniform(n) * room).long()
        lane["arm"][which] = self.place[clip]
        if not self.augment:
            return
        lane["mirrored"][which] = self._uniform(n) < 0.5
        lane["tempo"][which] = torch.exp(0.18 * (2 * self._uniform(n) - 1))
        pick = (self._uniform(n) * len(SMOOTHING)).long()
        lane["smoothing"][which] = SMOOTHING[pick]
        lane["height_error"][which] = torch.exp(0.02 * self._normal(n))
        # A third of the wearers have nearly ideal sensors: what tests by synthesis see.
        faulty = torch.where(self._uniform(n) < 0.33, 0.15, 1.0)[:, None, None]
        lane["arm"][which] += 0.03 * faulty * self._normal(n, COUNT, 3)
        lane["askew"][which] = 0.07 * faulty * self._normal(n, COUNT, 3)
        lane["bias"][which] = 0.08 * faulty * self._normal(n, COUNT, 3)
        lane["noise"][which] = 0.25 * faulty[:, 0, 0] * self._uniform(n)
        lane["drift"][which] = 0.07 * faulty[:, 0] * self._normal(n, COUNT)
        lane["drift_rate"][which] = 0.002 * faulty[:, 0] * self._normal(n, COUNT)
        lost = self._uniform(n, COUNT) < torch.where(self._uniform(n) < 0.12, 0.3, 0.0)[:, None]
        lost[:, -1] = False
        lane["seen"][which] = ~lost

    def _advance(self):
        """Renews ended lanes; returns which lanes (B,) begin with a fresh memory."""
        lane = self.lane
        need = lane["place"] + self.span + MARGIN
        ended = (need >= self.length[lane["clip"]]) | (lane["visit"] >= self.visit[lane["clip"]])
        ended = (ended & (lane["pause"] == 0)).nonzero().squeeze(1)
        reset = torch.zeros(self.batch, dtype=torch.bool)
        if len(ended):
            self._renew(ended)
            reset[ended] = ~lane["started"][ended] | (self._uniform(len(ended)) > SPLICE)
            lane["started"][ended] = True
        elif not self.augment:
            return reset
        stop = (self._uniform(self.batch) < PAUSE) & (lane["pause"] == 0) & ~reset
        length = 2 + (8 * self._uniform(self.batch)).long()
        lane["pause"] = torch.where(stop, length, lane["pause"])
        return reset

    def next_batch(self):
        """The next `frames` frames of every lane."""
        lane, motions = self.lane, self.motions
        reset = self._advance()
        still = lane["pause"] > 0
        first = motions.start[lane["clip"]] + lane["place"]
        steps = torch.arange(self.frames) * self.stride
        index = first[:, None] + torch.where(still[:, None], -self.stride, steps)
        moving = torch.where(still, 0, 1)[:, None]
        before, after = index - moving, index + moving
        tempo = lane["tempo"] * RATE
        height = motions.height[lane["clip"]] * lane["height_error"]
        leaves, joints, rotations, velocities = targets(
            motions, index, before, after, 2 / tempo, height, lane["mirrored"])
        start = (first - self.stride)[:, None]
        begin = targets(motions, start, start - moving, start + moving, 2 / tempo, height,
                        lane["mirrored"])
        contact = motions.contact[index]
        contact = torch.where(lane["mirrored"][:, None, None], contact.flip(-1), contact).float()
        contact = torch.where(still[:, None, None], 1.0, contact) if still.any() else contact
        seen = lane["seen"][:, None].expand(-1, self.frames, -1)
        batch = Batch(
            features(*self._sensors(index, moving), height, seen), leaves, joints, rotations,
            velocities, contact, begin[0][:, 0], begin[3][:, 0], reset, self.stride / tempo)
        lane["place"] += torch.where(still, 0, self.span)
        lane["pause"] -= still.long()
        lane["visit"] += 1
        return batch

    def _sensors(self, index, moving):
        """Rotations and accelerations that the lanes' sensors tell at frames (B, T)."""
        lane, motions = self.lane, self.motions
        around = torch.tensor([-1, 0, 1]) * (lane["smoothing"][:, None] * moving)
        taps = index.unsqueeze(-1) + around[:, None]
        turns = motions.turns[taps.unsqueeze(-1), torch.tensor(JOINTS_OF)].float()
        turns = turns / turns.norm(dim=-1, keepdim=True)
        places = motions.places[taps.unsqueeze(-1), torch.tensor(JOINTS_OF)]
        places = places + motions.root[taps].unsqueeze(-2)
        swap = lane["mirrored"]
        order = torch.tensor([1, 0, 3, 2, 4, 5])
        flip_q, flip_p = torch.tensor([1.0, -1.0, -1.0, 1.0]), torch.tensor([-1.0, 1.0, 1.0])
        chosen = swap[:, None, None, None, None]
        turns = torch.where(chosen, turns[:, :, :, order] * flip_q, turns)
        places = torch.where(chosen, places[:, :, :, order] * flip_p, places)
        arm = torch.where(swap[:, None, None], lane["arm"][:, order] * flip_p, lane["arm"])
        seconds = self.stride / (RATE * lane["tempo"])
        passed = seconds[:, None] * torch.arange(self.frames)
        drift = lane["drift"][:, None] + lane["drift_rate"][:, None] * passed.unsqueeze(-1)
        lane["drift"] = lane["drift"] + lane["drift_rate"] * (seconds * self.frames)[:, None]
        error = SensorError(rotvec_to_quat(lane["askew"]), drift, lane["bias"], lane["noise"],
                            self.generator)
        spread = lane["smoothing"] / (RATE * lane["tempo"])
        return measure(turns, places, arm, spread, error)
