"""The paper's Table 1 of `posed eval --tracker questsim`, as Markdown: by sensors (H+2C and H),
look-ahead (6, 2, 0), stature and kind of motion (by gait: stand, walk, jog, other).

    python -m questsim.report --posed PROGRAM --mocap DIR --out DIR [--model FILE]
        [--sets bandai,snu,fubot,cmu_amc,cmu_amc2] [--every 4] [--statures 1.55,1.75,1.95]

Each cell is one run of `posed eval` over every so many test clips of all sets, kept as JSON in --out;
what is there already is not run again, so an interrupted report goes on. Another model, or another
choice of clips, needs another folder. Look-ahead is in frames of 1/36 s; the tracker's answer lags
by 10, 4 and 0 ticks of 60 Hz. Statures are those of movers whose motion is scaled with them, with
H+2C and look-ahead 6. A run plays about eight times as fast as real time on one core: `--every 4` takes
some ten minutes, all clips three quarters of an hour.
"""

import argparse
import json
import subprocess
from pathlib import Path

SENSORS = {"hmd+controllers": "H+2C", "hmd": "H"}
# Ticks of 60 Hz within which so many frames of 1/36 s are measured.
TICKS = {6: 10, 2: 4, 0: 0}
COLUMNS = {
    "mpjre_geodesic_deg": "MPJRE deg", "mpjre_component_deg": "comp. deg",
    "mpjpe_root_cm": "MPJPE root cm", "mpjpe_head_cm": "head cm", "mpjpe_world_cm": "world cm",
    "root_position_cm": "RootE cm", "sip_deg": "SIP deg", "jitter_km_s3": "jitter km/s3",
    "true_jitter_km_s3": "truth's", "mhpe_cm": "MHPE cm", "mhre_deg": "MHRE deg",
}
PAPER = "| paper, LaFAN | H+2C | 6 | all | | | 5.7 | | 3.7 | | | 1.8 | 12.3 | 0.3 | | 3.7 | 8.4 | | | |"


def arguments():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--posed", required=True)
    parser.add_argument("--mocap", required=True)
    parser.add_argument("--out", required=True)
    parser.add_argument("--model", help="another policy than the built-in one")
    parser.add_argument("--sets", default="bandai,snu,fubot,cmu_amc,cmu_amc2")
    parser.add_argument("--every", default="4")
    parser.add_argument("--statures", default="1.55,1.75,1.95")
    parser.add_argument("--threads", default="1")
    return parser.parse_args()


def evaluate(args, sensors, lookahead, stature):
    """The report of one run."""
    path = Path(args.out) / f"{SENSORS[sensors]}.{lookahead}.{stature or 'own'}.json"
    if not path.exists():
        command = [args.posed, "eval", "--tracker", "questsim", "--kinds", "gait",
                   "--sensors", sensors, "--lookahead", str(TICKS[lookahead]),
                   "--every", args.every, "--threads", args.threads, "--json", str(path)]
        for name in args.sets.split(","):
            command += ["--data", f"{args.mocap}/{name}.npz"]
        command += ["--stature", stature] if stature else []
        command += ["--model", args.model] if args.model else []
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return json.loads(path.read_text())["report"]


def lines(sensors, lookahead, stature, report):
    """A line for each kind of motion, then one for all."""
    for row in [*report["classes"], report["all"]]:
        values = [row["scores"].get(column) for column in COLUMNS]
        numbers = " | ".join("-" if v is None else f"{v:.2f}" for v in values)
        yield (f"| {stature or 'own'} | {SENSORS[sensors]} | {lookahead} | {row['name']} | "
               f"{row['clips']} | {row['seconds'] / 60:.1f} | {numbers} | "
               f"{row['falls_per_minute']:.1f} | {100 * row['held_10s']:.0f} | "
               f"{100 * row['own']:.0f} |")


def main():
    args = arguments()
    Path(args.out).mkdir(parents=True, exist_ok=True)
    table = ["| stature m | sensors | look-ahead | motion | clips | min | "
             + " | ".join(COLUMNS.values()) + " | falls/min | held 10 s % | own % |",
             "|" + "---|" * (len(COLUMNS) + 9), PAPER]
    cells = [(sensors, lookahead, None) for sensors in SENSORS for lookahead in TICKS]
    cells += [("hmd+controllers", 6, stature) for stature in args.statures.split(",") if stature]
    for cell in cells:
        for line in lines(*cell, evaluate(args, *cell)):
            table.append(line)
            print(line, flush=True)
        (Path(args.out) / "table.md").write_text("\n".join(table) + "\n")


if __name__ == "__main__":
    main()
