"""Saving and loading of training state: atomic, and complete enough to go on bit by bit."""

import os
from pathlib import Path

import torch

from .model import CONFIGS, Config, HmdNemo


def build_model(name, config):
    """A model from its family's name and its configuration."""
    if name == "hmd_nemo":
        return HmdNemo(Config(**config) if isinstance(config, dict) else CONFIGS[config])
    from .avatar_poser import AvatarPoser, AvatarPoserConfig

    if name == "avatar_poser":
        return AvatarPoser(AvatarPoserConfig(**config) if isinstance(config, dict)
                           else AvatarPoserConfig())
    raise ValueError(f"no model family is called {name!r}: hmd_nemo or avatar_poser")


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
    kept = {k: state[k] for k in ("family", "config", "step", "seconds", "best", "arguments")}
    kept["average"] = {k: v.half() for k, v in state["average"].items()}
    save(path, kept)


def load_model(path, averaged=True):
    """The model of a checkpoint, in evaluation mode, with averaged weights by default."""
    state = load(path)
    model = build_model(state["family"], state["config"])
    weights = state["average"] if averaged else state["model"]
    model.load_state_dict({name: value.float() for name, value in weights.items()})
    return model.eval()
