"""Packs the training and validation clips into one compressed file each, to carry to a GPU machine.

    python -m hmd_nemo.pack --mocap DIR --out FOLDER [--sets a,b] [--amass DIR]

Then `python -m hmd_nemo.train --store FOLDER/train.npz --validation FOLDER/val.npz ...`.
"""

import argparse
from pathlib import Path

from posed_mocap import amass, store
from posed_mocap.clips import load_set


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mocap", required=True)
    parser.add_argument("--out", required=True)
    parser.add_argument("--sets", default=",".join(store.TRAIN_SETS))
    parser.add_argument("--amass", help="folder of AMASS SMPL+H .npz files, added to training")
    args = parser.parse_args()
    for split in ("train", "val"):
        clips = [
            clip for name in args.sets.split(",")
            for clip in load_set(Path(args.mocap) / f"{name}.npz", {split})
        ]
        if args.amass and split == "train":
            clips += list(amass.load_folder(Path(args.amass)))
        path = Path(args.out) / f"{split}.npz"
        store.export(store.pack(clips), path, compress=True)
        minutes = sum(len(c.root) for c in clips) / 3600
        print(f"{path}: {len(clips)} clips, {minutes:.1f} min, {path.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
