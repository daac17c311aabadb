"""Draws what training came to: falls a minute and reward against states seen, run after run.

    python -m questsim.plot ../models/questsim.history.jsonl questsim/pictures/curve.png
"""

import argparse
import json

import matplotlib
import numpy as np

from .worlds import WEIGHTS

matplotlib.use("Agg")
from matplotlib import pyplot  # noqa: E402

# Rounds or iterations that a mean is taken over.
SPAN = 9


def smooth(values):
    """Running mean over SPAN, over fewer at the ends."""
    kernel = np.ones(min(SPAN, len(values)))
    return np.convolve(values, kernel, "same") / np.convolve(np.ones(len(values)), kernel, "same")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("curve")
    parser.add_argument("out")
    args = parser.parse_args()
    with open(args.curve) as file:
        rows = [json.loads(line) for line in file]
    figure, axes = pyplot.subplots(1, 2, figsize=(8.5, 2.8))
    begin = 0.0
    for number in sorted({row["run"] for row in rows}):
        run = [row for row in rows if row["run"] == number and "terms" in row]
        states = begin + np.array([row.get("steps", row.get("states")) for row in run]) / 1e6
        kind = "PPO" if "iteration" in run[-1] else "DAgger"
        falls = [row["falls_per_minute"] for row in run]
        reward = [np.dot(row["terms"], WEIGHTS) for row in run]
        for panel, values in zip(axes, (falls, reward), strict=True):
            line, = panel.plot(states, smooth(values), label=f"{number + 1}: {kind}")
            panel.plot(states, values, ".", markersize=1, color=line.get_color(), alpha=0.3)
        begin = states[-1]
    axes[0].set_title("falls a minute, in training", fontsize=9)
    axes[1].set_title("reward (4) a step, in training", fontsize=9)
    # The first rounds fall most of the time.
    axes[0].set_ylim(0, 40)
    axes[0].legend(fontsize=7)
    for panel in axes:
        panel.set_xlabel("million states")
    figure.tight_layout()
    figure.savefig(args.out, dpi=90)


if __name__ == "__main__":
    main()
