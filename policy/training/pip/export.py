"""Writes a checkpoint as a stateful ONNX step, with card, metadata and golden vectors.

    python -m pip.export --checkpoint RUN/best.pt --out ../models --name pip_small
"""

import argparse
import hashlib
import json
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch

from . import checkpoint, golden
from .card import model_card
from .step import INPUTS, OUTPUTS, Step, example_inputs

OPSET = 17
TOLERANCE = 2e-4


def export(model, path):
    """The ONNX file of one step."""
    torch.onnx.export(
        Step(model).eval(), example_inputs(model), str(path), input_names=INPUTS,
        output_names=OUTPUTS, opset_version=OPSET, dynamo=False, do_constant_folding=True,
    )
    graph = onnx.load(str(path))
    keep_inputs(graph, model)
    onnx.save(graph, str(path))
    onnx.checker.check_model(graph, full_check=True)
    return graph


def keep_inputs(graph, model):
    """A runtime gives every input, also where an ablation does not use one."""
    given = {i.name: i for i in graph.graph.input}
    every = [
        given.get(name) or onnx.helper.make_tensor_value_info(
            name, onnx.TensorProto.FLOAT, list(example.shape))
        for name, example in zip(INPUTS, example_inputs(model))
    ]
    del graph.graph.input[:]
    graph.graph.input.extend(every)


def compare(model, path):
    """Largest difference between PyTorch and ONNX Runtime over the golden motion."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    _, _, _, x, leaves, velocities, _ = golden.motion_features()
    expected = golden.play(model, x, leaves, velocities)
    state, worst = example_inputs(model)[-1].numpy(), 0.0
    given = {i.name for i in session.get_inputs()}
    for i in range(len(x)):
        feed = [x[i : i + 1].numpy(), np.array([1.0 if i == 0 else 0.0], np.float32),
                leaves[None].numpy(), velocities[None].numpy(), state]
        feed = {n: v for n, v in zip(INPUTS, feed) if n in given}
        *answer, state = session.run(OUTPUTS, feed)
        for mine, theirs in zip(answer, expected):
            worst = max(worst, float(np.abs(mine[0] - theirs[i].numpy()).max()))
    return worst


def metadata(model, path, state, metrics):
    """What a runtime checks before it trusts the file, and where the weights come from."""
    example = example_inputs(model)
    outputs = Step(model).eval()(*example)
    sets = state["arguments"]["sets"].split(",")
    free = "bandai" not in sets
    return {
        "format": 1,
        "family": "pip",
        "rate_hz": 60,
        "lengths": "head heights",
        "parameters": sum(p.numel() for p in model.parameters()),
        "inputs": {n: list(t.shape) for n, t in zip(INPUTS, example)},
        "outputs": {n: list(t.shape) for n, t in zip(OUTPUTS, outputs)},
        "config": state["config"],
        "training": {
            "steps": state["step"], "hours": round(state["seconds"] / 3600, 3),
            "arguments": {k: v for k, v in state["arguments"].items()
                          if k not in ("mocap", "cache", "out", "start")},
        },
        "licence": "as its training data: free with credit" if free else
                   "CC BY-NC 4.0 (bandai in the training data): non-commercial use",
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "metrics": metrics,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--checkpoint", required=True)
    parser.add_argument("--out", required=True)
    parser.add_argument("--name", default="pip_small")
    parser.add_argument("--metrics", help="JSON written by pip.evaluate --out")
    args = parser.parse_args()
    out = Path(args.out)
    out.mkdir(parents=True, exist_ok=True)
    state = checkpoint.load(args.checkpoint)
    model = checkpoint.load_model(args.checkpoint)
    path = out / f"{args.name}.onnx"
    export(model, path)
    worst = compare(model, path)
    if worst > TOLERANCE:
        raise SystemExit(f"{path} differs from PyTorch by {worst:.2g}: not the same network")
    checkpoint.compact(out / "state" / f"{args.name}.pt", state)
    golden.write(model, out / f"{args.name}.golden.json")
    metrics = json.loads(Path(args.metrics).read_text()) if args.metrics else {}
    facts = metadata(model, path, state, metrics)
    (out / f"{args.name}.json").write_text(json.dumps(facts, indent=1) + "\n")
    (out / f"{args.name}.md").write_text(model_card(args.name, facts))
    print(f"{path}: {path.stat().st_size / 1e6:.2f} MB, differs from PyTorch by {worst:.1e}")


if __name__ == "__main__":
    main()
