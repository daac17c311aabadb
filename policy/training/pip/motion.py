"""Motions ready to take sensors from: every frame's joint positions and world rotations.

Worked out once and cached: forward kinematics and up-sampling would cost a CPU as much as the
networks do.
"""

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from posed_mocap import store as stores
from posed_mocap.rotations import quat_multiply
from posed_mocap.skeleton import JOINTS, PARENTS, forward_kinematics
from posed_mocap.rotations import quat_to_matrix

RATE = 60.0
SCALE = 32767.0


@dataclass
class Motions:
    """Frames of all clips back to back, at 60 Hz; lengths in metres."""

    turns: torch.Tensor
    """(n, 22, 4) int16: world rotations of the joints, times 32767."""
    places: torch.Tensor
    """(n, 22, 3) joints from the pelvis joint, world axes."""
    root: torch.Tensor
    """(n, 3) pelvis joint."""
    contact: torch.Tensor
    """(n, 2) bool: left, right foot stands."""
    start: torch.Tensor
    height: torch.Tensor
    """(clips,) head height of the skeleton."""
    offsets: torch.Tensor
    """(clips, 22, 3) bone offsets in the T-pose."""
    sources: list
    names: list

    def __len__(self):
        return len(self.names)

    def frames(self, clip):
        """Frame range of a clip: first, one past the last."""
        return int(self.start[clip]), int(self.start[clip + 1])


FOOT_JOINTS = [[7, 10], [8, 11]]
STILL = 0.3
"""A foot stands when its ankle or its toe joint is slower than this, m/s, and ..."""
NEAR = 0.10
"""... its toe joint less than this above where the clip's toes are when lowest, metres."""


def contacts(world, start, toe_floor):
    """(n, 2) bool from world joint positions (n, 22, 3); `toe_floor` (n,) metres."""
    velocity = torch.zeros_like(world)
    velocity[1:-1] = (world[2:] - world[:-2]) * (RATE / 2)
    edges = torch.cat([start[:-1], start[1:] - 1])
    velocity[edges] = 0
    standing = []
    for ankle, toe in FOOT_JOINTS:
        slow = torch.minimum(velocity[:, ankle].norm(dim=-1), velocity[:, toe].norm(dim=-1)) < STILL
        low = world[:, toe, 1] - toe_floor < NEAR
        standing.append(slow & low)
    return torch.stack(standing, -1)


def world_turns(local):
    """World quaternions from local ones, (n, 22, 4)."""
    out = [local[:, 0]]
    for joint in range(1, JOINTS):
        out.append(quat_multiply(out[PARENTS[joint]], local[:, joint]))
    return torch.stack(out, 1)


def build(store, block=20000):
    """Arrays of `Motions` from a store of clips."""
    count = len(store.root)
    owner = torch.repeat_interleave(torch.arange(len(store)), store.start[1:] - store.start[:-1])
    turns = torch.empty(count, JOINTS, 4, dtype=torch.int16)
    places = torch.empty(count, JOINTS, 3)
    for a in range(0, count, block):
        part = slice(a, a + block)
        local = store.quats[part].float()
        local = local / local.norm(dim=-1, keepdim=True)
        turns[part] = (world_turns(local) * SCALE).round().to(torch.int16)
        offsets = store.offsets[owner[part]]
        places[part] = forward_kinematics(quat_to_matrix(local), offsets)[1]
    world = places + store.root[:, None]
    floor = torch.empty(len(store))
    for clip in range(len(store)):
        a, b = store.frames(clip)
        floor[clip] = world[a:b, [10, 11], 1].min(1).values.quantile(0.05)
    return {
        "turns": turns.numpy(), "places": places.numpy(), "root": store.root.numpy(),
        "contact": contacts(world, store.start, floor[owner]).numpy(),
        "start": store.start.numpy(), "height": store.head_height.numpy(),
        "offsets": store.offsets.numpy(), "sources": np.array(store.sources),
        "names": np.array(store.names),
    }


def from_arrays(arrays):
    tensors = {k: torch.from_numpy(v) for k, v in arrays.items() if k not in ("sources", "names")}
    return Motions(**tensors, sources=[str(s) for s in arrays["sources"]],
                   names=[str(s) for s in arrays["names"]])


def cached(mocap, cache, sets, splits):
    """The motions of `sets` and `splits`, kept in a folder of memory-mapped arrays."""
    key = hashlib.sha256(repr((sorted(sets), sorted(splits), "v1")).encode()).hexdigest()[:12]
    folder = Path(cache) / f"pip-{'-'.join(sorted(splits))}-{key}"
    if not folder.exists():
        arrays = build(stores.cached(mocap, cache, sets, splits))
        partial = folder.with_suffix(f".{os.getpid()}.part")
        partial.mkdir(parents=True, exist_ok=True)
        for name, value in arrays.items():
            np.save(partial / f"{name}.npy", value)
        os.replace(partial, folder)
    return from_arrays({f.stem: np.load(f, mmap_mode="c") for f in folder.glob("*.npy")})
