"""Writes a checkpoint as a stateful ONNX step, with card, metadata and golden vectors.

    python -m hmd_nemo.export --checkpoint RUN/best.pt --out ../models --name hmd_nemo_small

Of the AvatarPoser baseline the ONNX file alone, to evaluate it by the same command.
"""

from pathlib import Path

import numpy as np
import torch

from common import checkpoint
from common.export import arguments, difference, metadata, publish, write_onnx

from . import golden
from .avatar_poser import AvatarPoser, WindowStep
from .card import model_card
from .checkpoint import load_model
from .step import INPUTS, OUTPUTS, Step, example_inputs


def export(model, path):
    """The ONNX file of one step."""
    if isinstance(model, AvatarPoser):
        step = WindowStep(model)
        example = step.example_inputs()
        # PyTorch's fused transformer has no ONNX form.
        torch.backends.mha.set_fastpath_enabled(False)
    else:
        step, example = Step(model), example_inputs(model)
    write_onnx(step, example, path, INPUTS, OUTPUTS)
    torch.backends.mha.set_fastpath_enabled(True)


def compare(model, path):
    """Largest difference between PyTorch and ONNX Runtime over the golden motion."""
    _, _, visible, features, _, _ = golden.motion_features()
    frames = [
        (features[i : i + 1].numpy(), visible[i : i + 1].float().numpy(),
         np.array([float(i == 0)], np.float32))
        for i in range(len(features))
    ]
    state = [t.detach().numpy() for t in example_inputs(model)[3:]]
    return difference(path, INPUTS, OUTPUTS, frames, state, golden.play(model, features, visible))


def facts(model, path, state, metrics):
    """The metadata; the auxiliary head does not ship and does not count."""
    example = example_inputs(model)
    outputs = Step(model).eval()(*example)
    parameters = sum(p.numel() for n, p in model.named_parameters()
                     if not n.startswith("auxiliary"))
    shapes = ({n: list(t.shape) for n, t in zip(INPUTS, example)},
              {n: list(t.shape) for n, t in zip(OUTPUTS, outputs)})
    return metadata("hmd_nemo", parameters, shapes, path, state, metrics)


def main():
    args = arguments(__doc__, "hmd_nemo_small")
    model = load_model(args.checkpoint)
    path = Path(args.out) / f"{args.name}.onnx"
    export(model, path)
    if isinstance(model, AvatarPoser):
        print(f"{path}: {path.stat().st_size / 1e6:.2f} MB, for `posed eval --model` only")
        return
    state = checkpoint.load(args.checkpoint)
    publish(args, path, compare(model, path), lambda metrics: facts(model, path, state, metrics),
            model_card, lambda out: golden.write(model, out))


if __name__ == "__main__":
    main()
