"""A network's step as ONNX, with card, metadata, golden vectors and state to train on from."""

import argparse
import hashlib
import json
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import torch

from . import checkpoint

OPSET = 17
TOLERANCE = 2e-4


def write_onnx(step, example, path, inputs, outputs):
    """The ONNX file of a module that takes `inputs` like `example` and answers `outputs`."""
    torch.onnx.export(step.eval(), example, str(path), input_names=inputs, output_names=outputs,
                      opset_version=OPSET, dynamo=False, do_constant_folding=True)
    graph = onnx.load(str(path))
    # A runtime gives every input, also where an ablation does not use one.
    given = {i.name: i for i in graph.graph.input}
    every = [
        given.get(name) or onnx.helper.make_tensor_value_info(
            name, onnx.TensorProto.FLOAT, list(each.shape))
        for name, each in zip(inputs, example)
    ]
    del graph.graph.input[:]
    graph.graph.input.extend(every)
    onnx.save(graph, str(path))
    onnx.checker.check_model(graph, full_check=True)


def difference(path, inputs, outputs, frames, states, expected):
    """Largest difference between PyTorch's answers and ONNX Runtime's over a motion.

    `frames`: the inputs of each frame without the state, arrays in order; `states`: the first
    state, which is the last of `inputs` and of `outputs`; `expected`: (n, ...) of each answer.
    """
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    worst = 0.0
    for i, frame in enumerate(frames):
        out = session.run(outputs, dict(zip(inputs, [*frame, *states])))
        answer, states = out[:len(expected)], out[len(expected):]
        for mine, theirs in zip(answer, expected):
            worst = max(worst, float(np.abs(mine[0] - theirs[i].numpy()).max()))
    return worst


def licence(sets):
    """Of weights that were trained on `sets`."""
    if "bandai" in sets:
        return "CC BY-NC 4.0 (bandai in the training data): non-commercial use"
    return "as its training data: free with credit"


def metadata(family, parameters, shapes, path, state, metrics):
    """What a runtime checks before it trusts the file, and where the weights come from.

    `shapes`: of the inputs and of the outputs, by name.
    """
    inputs, outputs = shapes
    unsaid = ("mocap", "store", "cache", "out", "start", "validation")
    return {
        "format": 1, "family": family, "rate_hz": 60, "lengths": "head heights",
        "parameters": parameters, "inputs": inputs, "outputs": outputs,
        "config": state["config"],
        "training": {
            "steps": state["step"], "hours": round(state["seconds"] / 3600, 3),
            "arguments": {k: v for k, v in state["arguments"].items() if k not in unsaid},
        },
        "licence": licence(state["arguments"]["sets"].split(",")),
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "metrics": metrics,
    }


def arguments(doc, name):
    parser = argparse.ArgumentParser(description=doc)
    parser.add_argument("--checkpoint", required=True)
    parser.add_argument("--out", required=True)
    parser.add_argument("--name", default=name)
    parser.add_argument("--metrics", help="JSON written by the family's evaluate --out")
    args = parser.parse_args()
    Path(args.out).mkdir(parents=True, exist_ok=True)
    return args


def publish(args, path, worst, facts, card, golden):
    """Writes everything beside the ONNX file.

    `worst`: its difference from PyTorch; `facts(metrics)`: the metadata; `card(name, facts)`:
    Markdown; `golden(path)` writes the golden vectors.
    """
    if worst > TOLERANCE:
        raise SystemExit(f"{path} differs from PyTorch by {worst:.2g}: not the same network")
    out = Path(args.out)
    checkpoint.compact(out / "state" / f"{args.name}.pt", checkpoint.load(args.checkpoint))
    golden(out / f"{args.name}.golden.json")
    told = facts(json.loads(Path(args.metrics).read_text()) if args.metrics else {})
    (out / f"{args.name}.json").write_text(json.dumps(told, indent=1) + "\n")
    (out / f"{args.name}.md").write_text(card(args.name, told))
    print(f"{path}: {path.stat().st_size / 1e6:.2f} MB, differs from PyTorch by {worst:.1e}")
