"""Saving and loading of training state: atomic, and complete enough to go on."""

import os
from pathlib import Path

import torch

from .model import CONFIGS, Config, Pip


def build_model(config):
    """A model from a configuration or its name."""
    return Pip(Config(**config) if isinstance(config, dict) else CONFIGS[config])


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
    kept = {k: state[k] for k in ("config", "step", "seconds", "best", "arguments")}
    kept["average"] = {k: v.half() for k, v in state["average"].items()}
    save(path, kept)


def load_model(path):
    """The model of a checkpoint with its averaged weights, in evaluation mode."""
    state = load(path)
    model = build_model(state["config"])
    model.load_state_dict({name: value.float() for name, value in state["average"].items()})
    return model.eval()
