"""The model card: what the weights are, from what data, how good, and under what licence."""

from common.card import data, flags, metric_table

COLUMNS = [
    ("sip_deg", "SIP deg"), ("angle_deg", "angle deg"), ("joint_cm", "joints cm"),
    ("leaf_cm", "leaves (P_L) cm"), ("way_cm_s", "way (V_A) cm/s"), ("contact", "contact right"),
]


def model_card(name, facts):
    """Markdown."""
    training, config = facts["training"], facts["config"]
    told = flags(training, ("model", "only", "batch", "frames", "stride", "rate", "shares",
                            "seed"))
    return f"""# {name}

PIP's five recurrent networks: a moving body from six inertial sensors (forearms, shanks, head,
pelvis), one frame at a time at 60 Hz. {facts['parameters'] / 1e6:.2f} M parameters: LSTMs of
{config['hidden']} units (contact: {config['contact']}); PIP's own are 256 and 64.
`policy/training/pip/FEATURES.md` has the exact layout of inputs, outputs and state.

- File: `{name}.onnx`, sha256 `{facts['sha256']}`
- State: {facts['inputs']['state'][1]} numbers, in and out with every frame
- Golden vectors: `{name}.golden.json` (procedural motion, no recorded data)
- Licence of the weights: {facts['licence']}.
- Training: {training['steps']} steps, {training['hours']:.2f} h on a share of one CPU core,
  last part: `python -m pip.train --mocap DIR --out RUN {told}`, then `python -m pip.export`

## Training data

Only the `train` split of the sets below; `val` chose the checkpoint. hdm05 and mass were never
trained on or tuned on, nor were test clips.

{data(training)}
## Errors of the kinematics alone

Means over clips of per-clip means, with the clips' own bones, ideal sensors in their usual
places, PyTorch, no physics. SIP: mean angle of hips and shoulders; angle: of all 15 predicted
joints; both, and the joints' distance, with the pelvis as the sensor tells it. Way: how far a
second's integrated pelvis velocity leads astray. Sets differ from those of published tables; no
number here is comparable with theirs. `posed eval --sensors imu6 --tracker pip` measures the
tracker as it runs, with physics.

{metric_table(facts['metrics'], COLUMNS)}
## Limits

Trained on few people and mostly on walking, gestures and idling. Lying, crawling and acrobatics
are outside. Sitting was learnt from made-up people alone.
"""
