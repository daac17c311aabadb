"""Plots the ground forces of a walk from a CSV: seconds, vertical force in newtons on the left foot, on
the right foot and on the whole body, and the probabilities that the feet stand.

    python -m pip.forces FORCES.csv --weight NEWTONS --from SECONDS --to SECONDS --out PLOT.png
"""

import argparse

import matplotlib
import numpy as np

matplotlib.use("Agg")
from matplotlib import pyplot  # noqa: E402


def strides(contact, time):
    """Times at which a foot is set down."""
    down = contact > 0.5
    return time[1:][down[1:] & ~down[:-1]]


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("forces")
    parser.add_argument("--weight", type=float, required=True)
    parser.add_argument("--from", dest="begin", type=float, default=0.0)
    parser.add_argument("--to", dest="end", type=float, default=1e9)
    parser.add_argument("--out", required=True)
    args = parser.parse_args()
    rows = np.loadtxt(args.forces, delimiter=",", skiprows=1)
    rows = rows[(rows[:, 0] >= args.begin) & (rows[:, 0] <= args.end)]
    time = rows[:, 0]
    steps = strides(rows[:, 4], time)
    if len(steps) > 1:
        whole = rows[(time >= steps[0]) & (time < steps[-1])]
        share = whole[:, 3].mean() / args.weight
        print(f"{len(steps) - 1} strides, mean ground force {share:.3f} of body weight")
    figure, axes = pyplot.subplots(figsize=(9, 3.4))
    for column, name, colour in ((1, "left foot", "tab:blue"), (2, "right foot", "tab:red")):
        axes.plot(time, rows[:, column], label=name, color=colour)
    axes.plot(time, rows[:, 3], label="both", color="0.4", linewidth=0.8)
    axes.axhline(args.weight, color="0.2", linestyle="--", linewidth=0.8, label="body weight")
    axes.set(xlabel="s", ylabel="vertical force, N", xlim=(time[0], time[-1]), ylim=(0, None))
    axes.legend(loc="upper right", ncols=4, fontsize=8)
    figure.tight_layout()
    figure.savefig(args.out, dpi=110)


if __name__ == "__main__":
    main()
