"""Writes a checkpoint as a stateful ONNX step, with card, metadata and golden vectors.

    python -m hmd_nemo.export --checkpoint RUN/best.pt --out ../models --name hmd_nemo_small

Of the AvatarPoser baseline the ONNX file alone, to evaluate it by the same command.
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
from .avatar_poser import AvatarPoser, WindowStep
from .card import model_card
from .step import INPUTS, OUTPUTS, Step, example_inputs

OPSET = 17
TOLERANCE = 2e-4


def export(model, path):
    """The ONNX file of one step."""
    if isinstance(model, AvatarPoser):
        step = WindowStep(model)
        example = step.example_inputs()
        # PyTorch's fused transformer has no ONNX form.
        torch.backends.mha.set_fastpath_enabled(False)
    else:
        step, example = Step(model), example_inputs(model)
    torch.onnx.export(
        step.eval(), example, str(path), input_names=INPUTS,
        output_names=OUTPUTS, opset_version=OPSET, dynamo=False, do_constant_folding=True,
    )
    torch.backends.mha.set_fastpath_enabled(True)
    onnx.checker.check_model(onnx.load(str(path)), full_check=True)


def compare(model, path):
    """Largest difference between PyTorch and ONNX Runtime over the golden motion."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    _, _, visible, features, _, _ = golden.motion_features()
    expected = golden.play(model, features, visible)
    _, _, _, *state = (t.detach().numpy() for t in example_inputs(model))
    worst = 0.0
    for i in range(len(features)):
        feed = [features[i : i + 1].numpy(), visible[i : i + 1].float().numpy(),
                np.array([1.0 if i == 0 else 0.0], np.float32), *state]
        *answer, a, b, c, d = session.run(OUTPUTS, dict(zip(INPUTS, feed)))
        state = [a, b, c, d]
        for mine, theirs in zip(answer, expected):
            worst = max(worst, float(np.abs(mine[0] - theirs[i].numpy()).max()))
    return worst


def metadata(model, path, state, metrics):
    """What a runtime checks before it trusts the file, and where the weights come from."""
    example = example_inputs(model)
    outputs = Step(model).eval()(*example)
    return {
        "format": 1,
        "family": "hmd_nemo",
        "rate_hz": 60,
        "lengths": "head heights",
        "parameters": sum(p.numel() for n, p in model.named_parameters()
                          if not n.startswith("auxiliary")),
        "inputs": {n: list(t.shape) for n, t in zip(INPUTS, example)},
        "outputs": {n: list(t.shape) for n, t in zip(OUTPUTS, outputs)},
        "config": state["config"],
        "training": {
            "steps": state["step"], "hours": round(state["seconds"] / 3600, 3),
            "arguments": {k: v for k, v in state["arguments"].items()
                          if k not in ("mocap", "store", "cache", "out", "validation")},
        },
        "licence": "CC BY-NC 4.0 (bandai in the training data): non-commercial use",
        "sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
        "metrics": metrics,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--checkpoint", required=True)
    parser.add_argument("--out", required=True)
    parser.add_argument("--name", default="hmd_nemo_small")
    parser.add_argument("--metrics", help="JSON written by hmd_nemo.evaluate --out")
    args = parser.parse_args()
    out = Path(args.out)
    out.mkdir(parents=True, exist_ok=True)
    state = checkpoint.load(args.checkpoint)
    model = checkpoint.load_model(args.checkpoint)
    path = out / f"{args.name}.onnx"
    export(model, path)
    if isinstance(model, AvatarPoser):
        print(f"{path}: {path.stat().st_size / 1e6:.2f} MB, for `posed eval --model` only")
        return
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
