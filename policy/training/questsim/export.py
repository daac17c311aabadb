"""Writes a student as ONNX with its card and its whole curve.

    python -m questsim.export --checkpoint TUNED/state.pt --out ../models
        --curve RUN/curve.jsonl TUNED/curve.jsonl

The curves are those of every run that led to it, in order.
"""

import argparse
import hashlib
import json
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch
from onnx import TensorProto, helper, numpy_helper

from . import mirror
from .character import HINGES
from .observation import RATE, SIZE, SUBSTEPS
from .student import CLAMP, Mlp

NAME = "questsim"
TOLERANCE = 1e-4


def graph(student):
    """The student, asked of what is seen and of its mirror image, as an ONNX model: `observation`
    (1, 475) to `torque` (1, 33)."""
    state = {key: value.numpy().astype(np.float32) for key, value in student.state_dict().items()}
    weights = {"mean": state["mean"], "scale": state["scale"],
               "low": np.float32(-CLAMP), "high": np.float32(CLAMP),
               "first": np.int64([0]), "second": np.int64([1])}
    for name, (index, sign) in (("seen", mirror.observation()),
                                ("done", (mirror.HINGES, 0.5 * mirror.TURNS))):
        weights[f"{name}_index"] = index.astype(np.int64)
        weights[f"{name}_sign"] = sign.astype(np.float32)
    weights["half"] = np.float32(0.5)
    node = helper.make_node
    nodes = [node("Gather", ["observation", "seen_index"], ["swapped"], axis=1),
             node("Mul", ["swapped", "seen_sign"], ["image"]),
             node("Concat", ["observation", "image"], ["both"], axis=0),
             node("Sub", ["both", "mean"], ["centred"]),
             node("Mul", ["centred", "scale"], ["scaled"]),
             node("Clip", ["scaled", "low", "high"], ["layer0"])]
    layers = sorted(int(key.split(".")[1]) for key in state if key.endswith("weight"))
    for number, layer in enumerate(layers):
        weights[f"w{number}"] = np.ascontiguousarray(state[f"layers.{layer}.weight"])
        weights[f"b{number}"] = state[f"layers.{layer}.bias"]
        nodes.append(node("Gemm", [f"layer{number}", f"w{number}", f"b{number}"],
                          [f"sum{number}"], transB=1))
        if number < len(layers) - 1:
            nodes.append(node("Elu", [f"sum{number}"], [f"layer{number + 1}"]))
    answers = f"sum{len(layers) - 1}"
    nodes += [node("Gather", [answers, "first"], ["straight"], axis=0),
              node("Gather", [answers, "second"], ["turned"], axis=0),
              node("Gather", ["turned", "done_index"], ["sided"], axis=1),
              node("Mul", ["sided", "done_sign"], ["back"]),
              node("Mul", ["straight", "half"], ["own"]),
              node("Add", ["own", "back"], ["torque"])]
    made = helper.make_graph(
        nodes, NAME, [helper.make_tensor_value_info("observation", TensorProto.FLOAT, [1, SIZE])],
        [helper.make_tensor_value_info("torque", TensorProto.FLOAT, [1, HINGES])],
        [numpy_helper.from_array(np.asarray(value), key) for key, value in weights.items()])
    model = helper.make_model(made, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    onnx.checker.check_model(model, full_check=True)
    return model


def compare(student, path):
    """Largest difference between PyTorch and ONNX Runtime."""
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    rng = np.random.default_rng(0)
    policy = mirror.Symmetric(student)
    worst = 0.0
    for _ in range(20):
        seen = rng.normal(0, 1, (1, SIZE)).astype(np.float32)
        seen = student.mean.numpy() + seen / student.scale.numpy()
        theirs = session.run(["torque"], {"observation": seen})[0]
        with torch.no_grad():
            mine = policy(torch.from_numpy(seen)).numpy()
        worst = max(worst, float(np.abs(mine - theirs).max()))
    return worst


CARD = """# questsim

QuestSim's policy (475-400-300-200-33, exponential linear units): torques over their limits for the
physics character from what it feels and what headset and controllers say; {rate:g} steps a second of
{substeps} physics steps. It is asked of what is seen and of its mirror image, and answers with the mean.
`policy/training/questsim/observation.py` has the order of the inputs.

- File: `questsim.onnx`, sha256 `{sha256}`; {parameters} parameters.
- Licence of the weights: CC BY-NC 4.0 (bandai in the training data): non-commercial use.
- Training: {history}; on two CPU cores. What was tried and what came of it: `policy/training/questsim/README.md`.
- Data, all of it of the `train` splits: bandai (Bandai-Namco-Research-Motiondataset, CC BY-NC 4.0), snu
  (snumrl/DataDrivenBipedController, MIT), fubot (Tomiha/FuBoT-VR-Dataset, MIT), cmu_amc and cmu_amc2 (data
  from mocap.cs.cmu.edu, created with funding from NSF EIA-0196217, free for research and commercial
  use): up to 107 minutes of walking, gestures and everyday motion, fewer in earlier stages.
- Last line of the curve: `{last}`
"""


def told(run):
    """A run in words, from its curve."""
    last = run[-1]
    tuned = "iteration" in last
    number, states = (last["iteration"], last["steps"]) if tuned else (last["round"], last["states"])
    kind = "iterations of PPO" if tuned else "rounds of DAgger"
    return f"{number} {kind} ({states:,} states, {last['hours']:.1f} h)"


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--checkpoint", required=True, help="state.pt of dagger or ppo")
    parser.add_argument("--curve", required=True, nargs="+", help="curve.jsonl of each run")
    parser.add_argument("--out", required=True)
    args = parser.parse_args()
    out = Path(args.out)
    state = torch.load(args.checkpoint, weights_only=True)
    student = Mlp()
    student.load_state_dict(state["student"])
    path = out / f"{NAME}.onnx"
    onnx.save(graph(student), path)
    worst = compare(student, path)
    if worst > TOLERANCE:
        raise SystemExit(f"ONNX and PyTorch differ by {worst}")
    runs = [[json.loads(line) for line in Path(curve).read_text().splitlines()]
            for curve in args.curve]
    facts = {
        "history": "; ".join(map(told, runs)),
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(), "rate": RATE,
        "substeps": SUBSTEPS, "parameters": sum(p.numel() for p in student.parameters()),
        "last": json.dumps(runs[-1][-1]),
    }
    (out / f"{NAME}.md").write_text(CARD.format(**facts))
    lines = [json.dumps({"run": number, **row}) for number, run in enumerate(runs) for row in run]
    (out / f"{NAME}.history.jsonl").write_text("\n".join(lines) + "\n")
    print(json.dumps(facts), f"ONNX differs by {worst:.1e}")


if __name__ == "__main__":
    main()
