"""Draws a run's losses and validation errors: `python -m hmd_nemo.plot RUN` writes RUN/run.png."""

import csv
import json
import sys
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt


def main():
    run = Path(sys.argv[1])
    with (run / "train.csv").open() as file:
        rows = list(csv.DictReader(file))
    validation = [json.loads(line) for line in (run / "validation.jsonl").open()]
    figure, (left, right) = plt.subplots(1, 2, figsize=(12, 4.5))
    steps = [int(r["step"]) for r in rows]
    for name in rows[0]:
        if name not in ("step", "seconds", "grad"):
            left.plot(steps, [float(r[name]) for r in rows], label=name)
    left.set(xlabel="step", yscale="log", title="training losses")
    left.legend(fontsize=7)
    for name in validation[0]["table"]:
        values = [v["table"][name]["mpjpe_cm"] for v in validation]
        right.plot([v["step"] for v in validation], values, label=name)
    right.set(xlabel="step", ylabel="MPJPE cm", yscale="log", title="validation")
    right.legend(fontsize=7)
    figure.tight_layout()
    figure.savefig(run / "run.png", dpi=110)


if __name__ == "__main__":
    main()
