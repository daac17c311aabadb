"""The command around a network's evaluation: flags, which clips, and its JSON."""

import argparse
import json
from pathlib import Path

from posed_mocap import store as stores


def parser(doc):
    parser = argparse.ArgumentParser(description=doc)
    parser.add_argument("--mocap", required=True)
    parser.add_argument("--cache", default=stores.default_cache())
    parser.add_argument("--checkpoint", required=True)
    parser.add_argument("--sets", required=True, help="comma-separated")
    parser.add_argument("--splits", required=True, help="comma-separated")
    parser.add_argument("--out")
    parser.add_argument("--per-set", type=int, help="at most so many clips of a set, evenly chosen")
    return parser


def clips_by_set(sources, per_set=None):
    """Yields each set's name and the numbers of its clips, thinned out evenly."""
    for name in sorted(set(sources)):
        clips = [c for c, source in enumerate(sources) if source == name]
        if per_set and len(clips) > per_set:
            clips = clips[:: -(-len(clips) // per_set)]
        yield name, clips


def mean_of(rows):
    """Means of rows with the same names."""
    return {name: sum(r[name] for r in rows) / len(rows) for name in rows[0]}


def write(rows, out):
    """Prints (name, row) as they come, and keeps all of them in the file `out`, if there is one."""
    result = {}
    for name, row in rows:
        result[name] = row
        values = " ".join(f"{k}={v:.3f}" for k, v in row.items() if isinstance(v, float))
        print(name, values, flush=True)
        if out:
            Path(out).write_text(json.dumps(result, indent=1))
