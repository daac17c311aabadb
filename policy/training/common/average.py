"""A running average of a model's weights: steadier than the last ones."""

import torch

KEEP = 0.998


class Average:
    """Follows a model step by step."""

    def __init__(self, model):
        self.model = model
        self.weights = {k: v.detach().clone() for k, v in model.state_dict().items()}

    def follow(self, step):
        """After `step`: a short memory at first, so that the beginning is soon forgotten."""
        keep = min(KEEP, (1 + step) / (10 + step))
        torch._foreach_lerp_(
            list(self.weights.values()), list(self.model.state_dict().values()), 1 - keep)

    def measure(self, function):
        """What `function` answers while the model has the averaged weights."""
        kept = {k: v.clone() for k, v in self.model.state_dict().items()}
        self.model.load_state_dict(self.weights)
        result = function(self.model)
        self.model.load_state_dict(kept)
        return result
