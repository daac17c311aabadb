"""AMASS and BVH files as one motion set that `posed eval` and the trainings read.

`python -m posed_mocap.convert OUT.npz FILE_OR_FOLDER... [--split test] [--scale METRES]`
"""

import argparse
import os
import sys
from pathlib import Path

import numpy as np
import torch

from . import amass
from .clips import RATE, to_posed_frame
from .rotations import quat_to_matrix
from .skeleton import JOINT_NAMES, PARENTS, forward_kinematics

FRAMES_MAX = 1_000_000
"""What one set may hold; more is for several sets."""


def encode_delta(quats):
    """Unit quaternions (n, 22, 4) as the low and high bytes of delta-coded int16 (88, n)."""
    values = np.rint(quats.reshape(len(quats), -1) * 32767.0).astype(np.int16)
    # Differences wrap; so does the sum that undoes them.
    delta = np.diff(values, axis=0, prepend=np.zeros((1, values.shape[1]), np.int16))
    unsigned = np.ascontiguousarray(delta.astype(np.int16).T).view(np.uint16)
    return (unsigned & 0xFF).astype(np.uint8), (unsigned >> 8).astype(np.uint8)


def toe_heights(clip):
    """Height of the lower toe joint in each frame, metres."""
    local = quat_to_matrix(torch.from_numpy(clip.quats))
    _, position = forward_kinematics(local, torch.from_numpy(clip.offsets))
    return position[:, [10, 11], 1].numpy().min(1) + clip.root[:, 1]


def arrays(clips):
    """The arrays of a set, in the sets' own frame (T-pose facing +Z)."""
    lengths = [len(clip.root) for clip in clips]
    if sum(lengths) > FRAMES_MAX:
        raise ValueError(f"{sum(lengths)} frames are too many for one set ({FRAMES_MAX}): split it")
    parts = [to_posed_frame(clip.quats, clip.root, clip.offsets) for clip in clips]
    coded = [encode_delta(quats) for quats, _, _ in parts]
    text = lambda values: np.array(list(values), dtype=np.str_)
    return {
        "dquat_lo": np.concatenate([low for low, _ in coded], axis=1),
        "dquat_hi": np.concatenate([high for _, high in coded], axis=1),
        "root": np.concatenate([root for _, root, _ in parts]).T,
        "start": np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32),
        "fps": np.array(int(RATE), np.int64),
        "src_fps": np.full(len(clips), RATE, np.float32),
        "offsets": np.stack([offsets for _, _, offsets in parts]).astype(np.float32),
        "head_height": np.array([clip.head_height for clip in clips], np.float32),
        "toe_p5": np.array([np.percentile(toe_heights(c), 5) for c in clips], np.float32),
        "names": text(clip.name for clip in clips),
        "subject": text(clip.source for clip in clips),
        "split": text(clip.split for clip in clips),
        "joint_names": text(JOINT_NAMES),
        "parents": np.array(PARENTS, np.int64),
        "pseudo_joint": np.zeros(len(PARENTS), bool),
    }


def write(clips, path):
    """Writes clips as one set, whole or not at all."""
    if not clips:
        raise ValueError("nothing to convert: no AMASS (.npz) or BVH (.bvh) file was found")
    partial = Path(path).with_suffix(f".{os.getpid()}.part.npz")
    # posed reads arrays in C order only.
    ordered = {name: np.ascontiguousarray(array) for name, array in arrays(clips).items()}
    ordered["fps"] = ordered["fps"].reshape(())
    np.savez_compressed(partial, **ordered)
    os.replace(partial, path)


def load(path, split, scale):
    """One file as a clip; None for a file without motion."""
    if path.suffix.lower() == ".bvh":
        from . import bvh  # Only who converts BVH needs its reader.

        return bvh.load_file(path, split, scale)
    clip = amass.load_file(path)
    if clip is not None:
        clip.split = split
    return clip


def find(sources):
    """The motion files among files and folders, in name order."""
    for source in map(Path, sources):
        if source.is_dir():
            wanted = {".npz", ".bvh"}
            yield from sorted(p for p in source.rglob("*") if p.suffix.lower() in wanted)
        else:
            yield source


def main(arguments=None):
    """Converts; a file that cannot be read is named and left out."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="the set to write (.npz)")
    parser.add_argument("sources", nargs="+", help="AMASS (.npz) and BVH files, or folders of them")
    parser.add_argument("--split", default="test", help="the split to put the clips in")
    parser.add_argument("--scale", type=float, help="metres a unit of BVH; guessed if left out")
    args = parser.parse_args(arguments)
    clips, failed = [], 0
    for path in find(args.sources):
        try:
            clip = load(path, args.split, args.scale)
        except (OSError, ValueError, KeyError, IndexError) as error:
            failed += 1
            print(f"{path}: {error}", file=sys.stderr)
            continue
        if clip is not None:
            clips.append(clip)
    try:
        write(clips, args.out)
    except ValueError as error:
        sys.exit(str(error))
    minutes = sum(len(clip.root) for clip in clips) / RATE / 60
    print(f"{args.out}: {len(clips)} clips, {minutes:.1f} minutes; {failed} files left out")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
