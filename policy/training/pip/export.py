"""Writes a checkpoint as a stateful ONNX step, with card, metadata and golden vectors.

    python -m pip.export --checkpoint RUN/best.pt --out ../models --name pip_small
"""

from pathlib import Path

import numpy as np

from common import checkpoint
from common.export import arguments, difference, metadata, publish, write_onnx

from . import golden
from .card import model_card
from .checkpoint import load_model
from .step import INPUTS, OUTPUTS, Step, example_inputs


def export(model, path):
    """The ONNX file of one step."""
    write_onnx(Step(model), example_inputs(model), path, INPUTS, OUTPUTS)


def compare(model, path):
    """Largest difference between PyTorch and ONNX Runtime over the golden motion."""
    _, _, _, x, leaves, velocities, _ = golden.motion_features()
    frames = [
        (x[i : i + 1].numpy(), np.array([float(i == 0)], np.float32), leaves[None].numpy(),
         velocities[None].numpy())
        for i in range(len(x))
    ]
    state = [example_inputs(model)[-1].numpy()]
    return difference(
        path, INPUTS, OUTPUTS, frames, state, golden.play(model, x, leaves, velocities))


def facts(model, path, state, metrics):
    """The metadata."""
    example = example_inputs(model)
    outputs = Step(model).eval()(*example)
    shapes = ({n: list(t.shape) for n, t in zip(INPUTS, example)},
              {n: list(t.shape) for n, t in zip(OUTPUTS, outputs)})
    parameters = sum(p.numel() for p in model.parameters())
    return metadata("pip", parameters, shapes, path, state, metrics)


def main():
    args = arguments(__doc__, "pip_small")
    model = load_model(args.checkpoint)
    path = Path(args.out) / f"{args.name}.onnx"
    export(model, path)
    state = checkpoint.load(args.checkpoint)
    publish(args, path, compare(model, path), lambda metrics: facts(model, path, state, metrics),
            model_card, lambda out: golden.write(model, out))


if __name__ == "__main__":
    main()
