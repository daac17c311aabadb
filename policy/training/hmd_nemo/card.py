"""The model card: what the weights are, from what data, how good, and under what licence."""

from common.card import data, flags, metric_table

COLUMNS = [
    ("mpjpe_cm", "MPJPE cm"), ("mpjve_cm_s", "MPJVE cm/s"),
    ("mpjre_component_deg", "MPJRE comp. deg"), ("mpjre_geodesic_deg", "MPJRE geod. deg"),
    ("root_deg", "root deg"), ("jitter_km_s3", "jitter km/s3"),
    ("true_jitter_km_s3", "true jitter"), ("foot_skate_cm_s", "skate cm/s"),
]
SEEN = [("hands seen", lambda row: " / ".join(f"{100 * v:.0f} %" for v in row["visible"]))]


def model_card(name, facts):
    """Markdown."""
    training = facts["training"]
    told = flags(training, ("model", "family", "batch", "frames", "stride", "rate", "decay",
                            "until_decay", "steps", "shares", "seed"))
    return f"""# {name}

HMD-NeMo: whole-body pose from a headset and two hands that may be out of view, one frame at a
time at 60 Hz. {facts['parameters'] / 1e6:.2f} M parameters. `policy/training/FEATURES.md` has the
exact layout of inputs, outputs and state.

- File: `{name}.onnx`, sha256 `{facts['sha256']}`
- Golden vectors: `{name}.golden.json` (procedural motion, no recorded data)
- Licence of the weights: {facts['licence']}.
- Training: {training['steps']} steps, {training['hours']:.2f} h on two shared CPU cores,
  last part: `python -m hmd_nemo.train --mocap DIR --out RUN {told}`, then
  `python -m hmd_nemo.export`. Where the run had several parts, `{name}.history.md` tells them.

## Training data

Only the `train` split of the sets below; `val` chose the checkpoint. hdm05 and mass were never
trained on or tuned on, nor were test clips.

{data(training)}
## Errors

Head-aligned, with the clips' own bone lengths, means over clips of per-clip means, first frame
dropped, ideal sensors at the head and wrist joints, Python implementation, no refinement and no
physics. Sets differ from those of published tables; no number here is comparable with theirs.
`controllers`: hands always there. `field_of_view`: hands inside a frustum like HoloLens 2's, with
random loss.

{metric_table(facts['metrics'], COLUMNS, SEEN)}
## Limits

Trained on few people and mostly on walking, gestures and idling. Lying, crawling and acrobatics
are outside. The median pitch of the head joint differs between the sets (-6 to +23 degrees); the
training disturbs it on purpose, a live headset still needs its fixed turn to the skull.
"""
