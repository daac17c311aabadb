"""One compact file of clips, ready to train from, and its cache.

The file holds every frame back to back: int16 quaternions and float32 roots. It is what travels
to a GPU machine; the shared `.npz` sets stay where they are.
"""

import hashlib
import os
from pathlib import Path

import numpy as np
import torch

from .clips import load_set

QUAT_SCALE = 32767.0
TRAIN_SETS = [
    "bandai", "snu", "fubot", "cmu_amc2", "cmu_amc", "cmu_bvh", "cmu_cc", "cmu_expmap",
    "cmu_poser", "reactidle",
]
"""Sets whose `train` split may be trained on. hdm05 and mass never may."""


class Store:
    """Clips as flat tensors: `quats` int16 (n, 22, 4), `root` (n, 3), per-clip arrays."""

    def __init__(self, arrays):
        self.quats = torch.from_numpy(arrays["quats"])
        self.root = torch.from_numpy(arrays["root"])
        self.start = torch.from_numpy(arrays["start"]).long()
        self.offsets = torch.from_numpy(arrays["offsets"])
        self.head_height = torch.from_numpy(arrays["head_height"])
        self.sources = [str(s) for s in arrays["sources"]]
        self.names = [str(s) for s in arrays["names"]]

    def __len__(self):
        return len(self.names)

    def frames(self, clip):
        """Frame range of a clip: first, one past the last."""
        return int(self.start[clip]), int(self.start[clip + 1])


def pack(clips):
    """Arrays of a store from an iterable of `Clip`."""
    clips = list(clips)
    if not clips:
        raise ValueError("no clip matches: check the folder of mocap sets and the split names")
    lengths = [len(c.root) for c in clips]
    return {
        "quats": np.concatenate([np.rint(c.quats * QUAT_SCALE).astype(np.int16) for c in clips]),
        "root": np.concatenate([c.root for c in clips]).astype(np.float32),
        "start": np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64),
        "offsets": np.stack([c.offsets for c in clips]).astype(np.float32),
        "head_height": np.array([c.head_height for c in clips], np.float32),
        "sources": np.array([c.source for c in clips]),
        "names": np.array([c.name for c in clips]),
    }


def load(path):
    """Reads a file written by `export`."""
    with np.load(path, allow_pickle=False) as data:
        return Store({key: data[key] for key in data.files})


def export(arrays, path, compress=False):
    """Writes the arrays as one `.npz`, atomically. Compressed for carrying to another machine."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    # Workers that start together may all find no file: each writes its own.
    partial = path.with_suffix(f".{os.getpid()}.part.npz")
    (np.savez_compressed if compress else np.savez)(partial, **arrays)
    os.replace(partial, path)


def cached(mocap_dir, cache_dir, sets, splits):
    """A store of `sets` and `splits`, decoded once and kept under `cache_dir`."""
    key = hashlib.sha256(repr((sorted(sets), sorted(splits), "v1")).encode()).hexdigest()[:12]
    path = Path(cache_dir) / f"mocap-{'-'.join(sorted(splits))}-{key}.npz"
    if not path.exists():
        folder = Path(mocap_dir)
        clips = [c for name in sets for c in load_set(folder / f"{name}.npz", set(splits))]
        export(pack(clips), path)
    return load(path)


def default_cache():
    """`$XDG_CACHE_HOME/posed-training`, or the same under `~/.cache`."""
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(base) / "posed-training"
