"""Models from names, configurations and checkpoints."""

from common import checkpoint

from .model import CONFIGS, Config, Pip


def build_model(config):
    """A model from a configuration or its name."""
    return Pip(Config(**config) if isinstance(config, dict) else CONFIGS[config])


def load_model(path):
    """The model of a checkpoint with its averaged weights, in evaluation mode."""
    state = checkpoint.load(path)
    return checkpoint.with_weights(build_model(state["config"]), state["average"])
