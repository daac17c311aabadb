"""Models from names, configurations and checkpoints."""

from common import checkpoint

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


def load_model(path, averaged=True):
    """The model of a checkpoint, in evaluation mode, with averaged weights by default."""
    state = checkpoint.load(path)
    model = build_model(state["family"], state["config"])
    return checkpoint.with_weights(model, state["average" if averaged else "model"])
