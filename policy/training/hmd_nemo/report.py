"""The table of `posed eval` over sets, sensors, trackers, refinement and physics, as Markdown, and
what it says of the aims.

    python -m hmd_nemo.report --posed PROGRAM --mocap DIR --out DIR [--model FILE]
        [--baseline FILE] [--rows ik,refined] [--sets bandai/test:6,hdm05/cross | quick]

Each cell is one run of `posed eval`, kept as JSON in --out; what is there already is not run
again, so an interrupted report goes on and other rows can be added: another model needs another
folder. `:6` takes every sixth clip; the table says so, and how many clips that are. `quick` takes
about a quarter of an hour of one core with the small model, the baseline included.
"""

import argparse
import json
import subprocess
from pathlib import Path

SETS = ("bandai/test:6,snu/test,fubot/test,cmu_amc/test,cmu_amc2/test:2,cmu_bvh/test,"
        "cmu_cc/test,hdm05/cross:2,mass/ood")
QUICK = ("bandai/test:12,snu/test:4,fubot/test:6,cmu_amc/test,cmu_amc2/test:8,cmu_bvh/test,"
         "cmu_cc/test:6,hdm05/cross:3,mass/ood")
SENSORS = {"hmd+controllers": "always", "hmd+hands": "in view"}
RAW = ["--tracker", "hmd_nemo", "--unrefined", "--unmirrored"]
ROWS = {
    "ik": ("ik", ["--tracker", "ik"]),
    "ik-physics": ("ik, physics", ["--tracker", "ik", "--physics"]),
    "baseline": ("AvatarPoser", RAW + ["--model", "{baseline}"]),
    "raw": ("HMD-NeMo, network alone", RAW + ["--model", "{model}"]),
    "unrefined": ("HMD-NeMo, mirrored", RAW[:3] + ["--model", "{model}"]),
    "refined": ("HMD-NeMo, as it ships", RAW[:2] + ["--model", "{model}"]),
    "physics": ("HMD-NeMo, physics", RAW[:2] + ["--model", "{model}", "--physics"]),
}
COLUMNS = {
    "mpjpe_head_cm": "MPJPE head cm", "mpjpe_world_cm": "MPJPE world cm",
    "mpjre_geodesic_deg": "MPJRE geod. deg", "mpjre_component_deg": "MPJRE comp. deg",
    "mpjve_cm_s": "MPJVE cm/s", "jitter_km_s3": "jitter km/s3", "true_jitter_km_s3": "true jitter",
    "foot_skate_cm": "skate cm", "foot_slide_cm_s": "slide cm/s", "true_foot_slide_cm_s": "true slide",
}


def arguments():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--posed", required=True)
    parser.add_argument("--mocap", required=True)
    parser.add_argument("--out", required=True)
    parser.add_argument("--model", default="../models/hmd_nemo_small.onnx")
    parser.add_argument("--baseline", help="the baseline as written by hmd_nemo.export")
    parser.add_argument("--rows", default="ik,ik-physics,baseline,raw,unrefined,refined,physics")
    parser.add_argument("--sets", default=SETS)
    parser.add_argument("--threads", default="1")
    return parser.parse_args()


def set_name(cell):
    """`bandai/test:6` in words."""
    name, _, every = cell.partition(":")
    return f"{name}, 1 clip of {every}" if every else name


def evaluate(args, row, cell, sensors):
    """The JSON of one run."""
    name, _, every = cell.partition(":")
    data, split = name.split("/")
    tag = cell.replace("/", "-").replace(":", "-every-")
    path = Path(args.out) / f"{row}.{sensors}.{tag}.json"
    if not path.exists():
        flags = [f.format(model=args.model, baseline=args.baseline) for f in ROWS[row][1]]
        command = [args.posed, "eval", "--data", f"{args.mocap}/{data}.npz", "--split", split,
                   "--sensors", sensors, "--every", every or "1", "--threads", args.threads,
                   "--json", str(path), *flags]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return json.loads(path.read_text())["report"]["all"]


def findings(found):
    """What the scores, by (cell, sensors, row), say of the aims, a line for each set: hands in view
    against always, physics against none, HMD-NeMo against the baseline."""
    def score(cell, sensors, row, column):
        return found.get((cell, sensors, row), {}).get(column)

    always, in_view = SENSORS
    kinds = (
        ("MPJPE of hands in view over always", "mpjpe_head_cm", (in_view, "refined"),
         (always, "refined")),
        ("MPJPE with physics over without", "mpjpe_head_cm", (always, "physics"),
         (always, "refined")),
        ("foot skate with physics over without", "foot_skate_cm", (always, "physics"),
         (always, "refined")),
        ("MPJPE over the baseline's", "mpjpe_head_cm", (always, "raw"), (always, "baseline")),
        ("MPJVE over the baseline's", "mpjve_cm_s", (always, "raw"), (always, "baseline")),
    )
    for title, column, above, below in kinds:
        for cell in dict.fromkeys(key[0] for key in found):
            values = [score(cell, *which, column) for which in (above, below)]
            if None not in values and values[1] > 0:
                yield (f"- {title}, {set_name(cell)}: {values[0]:.2f} / {values[1]:.2f} = "
                       f"{values[0] / values[1]:.2f}")


def main():
    args = arguments()
    Path(args.out).mkdir(parents=True, exist_ok=True)
    rows = [r for r in args.rows.split(",") if r != "baseline" or args.baseline]
    lines = ["| set | hands | tracker | clips | " + " | ".join(COLUMNS.values()) + " |",
             "|" + "---|" * (len(COLUMNS) + 4)]
    found = {}
    for cell in (QUICK if args.sets == "quick" else args.sets).split(","):
        for sensors, hands in SENSORS.items():
            for row in rows:
                all_clips = evaluate(args, row, cell, sensors)
                scores = found[cell, sensors, row] = all_clips["scores"]
                values = [scores.get(column) for column in COLUMNS]
                numbers = " | ".join("-" if v is None else f"{v:.2f}" for v in values)
                lines.append(f"| {set_name(cell)} | {hands} | {ROWS[row][0]} | "
                             f"{all_clips['clips']} | {numbers} |")
                print(lines[-1], flush=True)
                text = "\n".join([*lines, "", *findings(found)]) + "\n"
                (Path(args.out) / "table.md").write_text(text)
    print("\n".join(findings(found)))


if __name__ == "__main__":
    main()
