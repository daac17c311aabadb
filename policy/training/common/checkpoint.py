"""Training state in files: atomic, and complete enough to go on."""

import os
from pathlib import Path

import torch


def save(path, state):
    """Writes beside the file and renames, so that a cut leaves the old one whole."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(path.suffix + ".part")
    torch.save(state, partial)
    os.replace(partial, path)


def load(path):
    return torch.load(path, map_location="cpu", weights_only=True)


def compact(path, state):
    """The averaged weights alone, in float16: small enough to keep, good to begin again from."""
    kept = {k: state[k] for k in ("family", "config", "step", "seconds", "best", "arguments")
            if k in state}
    kept["average"] = {k: v.half() for k, v in state["average"].items()}
    save(path, kept)


def with_weights(model, weights):
    """`model` in evaluation mode with saved weights of any precision."""
    model.load_state_dict({name: value.float() for name, value in weights.items()})
    return model.eval()
