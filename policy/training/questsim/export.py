"""Writes a student as ONNX with its card.

`python -m questsim.export --checkpoint RUN/state.pt --curve RUN/curve.jsonl --out ../models`
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

from .character import HINGES
from .observation import RATE, SIZE, SUBSTEPS
from .student import CLAMP, Mlp

NAME = "questsim"
TOLERANCE = 1e-4


def graph(student):
    """The student as an ONNX model: `observation` (1, 475) to `torque` (1, 33)."""
    state = {key: value.numpy().astype(np.float32) for key, value in student.state_dict().items()}
    weights = {"mean": state["mean"], "scale": state["scale"],
               "low": np.float32(-CLAMP), "high": np.float32(CLAMP)}
    nodes = [helper.make_node("Sub", ["observation", "mean"], ["centred"]),
             helper.make_node("Mul", ["centred", "scale"], ["scaled"]),
             helper.make_node("Clip", ["scaled", "low", "high"], ["layer0"])]
    layers = sorted(int(key.split(".")[1]) for key in state if key.endswith("weight"))
    for number, layer in enumerate(layers):
        weights[f"w{number}"] = np.ascontiguousarray(state[f"layers.{layer}.weight"])
        weights[f"b{number}"] = state[f"layers.{layer}.bias"]
        last = number == len(layers) - 1
        out = "torque" if last else f"sum{number}"
        nodes.append(helper.make_node(
            "Gemm", [f"layer{number}", f"w{number}", f"b{number}"], [out], transB=1))
        if not last:
            nodes.append(helper.make_node("Tanh", [out], [f"layer{number + 1}"]))
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
    worst = 0.0
    for _ in range(20):
        seen = rng.normal(0, 1, (1, SIZE)).astype(np.float32)
        seen = student.mean.numpy() + seen / student.scale.numpy()
        theirs = session.run(["torque"], {"observation": seen})[0]
        with torch.no_grad():
            mine = student(torch.from_numpy(seen)).numpy()
        worst = max(worst, float(np.abs(mine - theirs).max()))
    return worst


CARD = """# questsim

QuestSim's policy (475-400-300-200-33, tanh): torques over their limits for the physics character
from what it feels and what headset and controllers say; {rate:g} steps a second of {substeps}
physics steps. `policy/training/questsim/observation.py` has the order of the inputs.

- File: `questsim.onnx`, sha256 `{sha256}`; {parameters} parameters.
- Licence of the weights: CC BY-NC 4.0 (bandai in the training data): non-commercial use.
- Training: {history}. What was tried and what came of it: `policy/training/questsim/README.md`.
- Data: a fifth of the clips of the `train` split of bandai (Bandai-Namco-Research-Motiondataset, CC BY-NC
  4.0; walking, running, gestures) and snu (snumrl/DataDrivenBipedController, MIT), 33 minutes.
- Last line of the curve: `{last}`
"""


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--checkpoint", required=True, help="state.pt of dagger or ppo")
    parser.add_argument("--curve", required=True, help="curve.jsonl beside it")
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
    last = Path(args.curve).read_text().splitlines()[-1]
    kind = "iterations of PPO" if "iteration" in state else "rounds of DAgger"
    number = state.get("iteration", state.get("round"))
    states = state.get("steps", state.get("samples"))
    facts = {
        "history": f"{number} {kind}, {states} states, {state['seconds'] / 3600:.2f} h of wall time",
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(), "rate": RATE,
        "substeps": SUBSTEPS, "parameters": sum(p.numel() for p in student.parameters()),
        "last": last,
    }
    (out / f"{NAME}.md").write_text(CARD.format(**facts))
    (out / f"{NAME}.history.jsonl").write_text(Path(args.curve).read_text())
    print(json.dumps(facts), f"ONNX differs by {worst:.1e}")


if __name__ == "__main__":
    main()
