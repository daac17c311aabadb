"""Draws what training came to: falls a minute and the student's error against states seen.

    python -m questsim.plot ../models/questsim.history.jsonl questsim/pictures/curve.png
"""

import argparse
import json

import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot  # noqa: E402

# Rounds that a mean is taken over.
SPAN = 9


def smooth(values):
    """Running mean over SPAN rounds, over fewer at the ends."""
    kernel = np.ones(min(SPAN, len(values)))
    return np.convolve(values, kernel, "same") / np.convolve(np.ones(len(values)), kernel, "same")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("curve")
    parser.add_argument("out")
    args = parser.parse_args()
    with open(args.curve) as file:
        rows = [row for row in map(json.loads, file) if "states" in row]
    states = np.array([row["states"] for row in rows]) / 1e3
    figure, axes = pyplot.subplots(1, 2, figsize=(8.5, 2.8))
    panels = (("falls_per_minute", "falls a minute, random starts, half shaken", "linear"),
              ("error", "mean square error against the expert", "log"))
    for panel, (key, name, scale) in zip(axes, panels, strict=True):
        values = np.array([row.get(key, np.nan) for row in rows])
        known = np.isfinite(values)
        panel.plot(states[known], values[known], ".", markersize=2, color="0.6")
        panel.plot(states[known], smooth(values[known]), color="tab:blue")
        panel.set(xlabel="thousand states", title=name, yscale=scale)
        panel.title.set_fontsize(9)
    # The first rounds fall most of the time.
    axes[0].set_ylim(0, 40)
    figure.tight_layout()
    figure.savefig(args.out, dpi=90)


if __name__ == "__main__":
    main()
