"""The model card: what the weights are, from what data, how good, and under what licence."""

DATA = """\
| set | licence |
|---|---|
| bandai: Bandai-Namco-Research-Motiondataset | CC BY-NC 4.0 |
| cmu_*: CMU Graphics Lab Motion Capture Database, mocap.cs.cmu.edu, NSF EIA-0196217 | free for research and commercial use with credit |
| snu: snumrl/DataDrivenBipedController | MIT |
| fubot: Tomiha/FuBoT-VR-Dataset | MIT |
| reactidle: Enekoassets/ReActIdle | MIT |
"""
COLUMNS = [
    ("mpjpe_cm", "MPJPE cm"), ("mpjve_cm_s", "MPJVE cm/s"),
    ("mpjre_component_deg", "MPJRE comp. deg"), ("mpjre_geodesic_deg", "MPJRE geod. deg"),
    ("root_deg", "root deg"), ("jitter_km_s3", "jitter km/s3"),
    ("true_jitter_km_s3", "true jitter"), ("foot_skate_cm_s", "skate cm/s"),
]


def metric_rows(metrics):
    """A Markdown table from `hmd_nemo.evaluate`'s JSON, or a line that says there is none."""
    if not metrics:
        return "Not evaluated.\n"
    head = "| set / hands | clips | hands seen | " + " | ".join(t for _, t in COLUMNS) + " |"
    rows = [head, "|" + "---|" * (len(COLUMNS) + 3)]
    for name, row in metrics.items():
        seen = " / ".join(f"{100 * v:.0f} %" for v in row["visible"])
        cells = " | ".join(f"{row[k]:.2f}" for k, _ in COLUMNS)
        rows.append(f"| {name} | {row['clips']} | {seen} | {cells} |")
    return "\n".join(rows) + "\n"


def model_card(name, facts):
    """Markdown."""
    training = facts["training"]
    flags = " ".join(
        f"--{k.replace('_', '-')} {v}" for k, v in training["arguments"].items()
        if k in ("model", "family", "batch", "frames", "rate", "decay", "until_decay", "steps", "seed", "sets")
    )
    return f"""# {name}

HMD-NeMo: whole-body pose from a headset and two hands that may be out of view, one frame at a
time at 60 Hz. {facts['parameters'] / 1e6:.2f} M parameters. `policy/training/FEATURES.md` has the
exact layout of inputs, outputs and state.

- File: `{name}.onnx`, sha256 `{facts['sha256']}`
- Golden vectors: `{name}.golden.json` (procedural motion, no recorded data)
- Licence of the weights: {facts['licence']}.
- Training: {training['steps']} steps, {training['hours']:.2f} h on two shared CPU cores,
  last part: `python -m hmd_nemo.train --mocap DIR --out RUN {flags}`, then
  `python -m hmd_nemo.export`. Where the run had several parts, `{name}.history.md` tells them.

## Training data

Only the `train` split of the sets below; `val` chose the checkpoint. hdm05 and mass were never
trained on or tuned on, nor were test clips.

{DATA}
## Errors

Head-aligned, with the clips' own bone lengths, means over clips of per-clip means, first frame
dropped, ideal sensors at the head and wrist joints, Python implementation, no refinement and no
physics. Sets differ from those of published tables; no number here is comparable with theirs.
`controllers`: hands always there. `field_of_view`: hands inside a frustum like HoloLens 2's, with
random loss.

{metric_rows(facts['metrics'])}
## Limits

Trained on few people and mostly on walking, gestures and idling. Lying, crawling and acrobatics
are outside. The median pitch of the head joint differs between the sets (-6 to +23 degrees); the
training disturbs it on purpose, a live headset still needs its fixed turn to the skull.
"""
