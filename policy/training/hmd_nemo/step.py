"""The network as one frame: what is exported. State in, state out, batch 1, no control flow."""

import torch
from torch import nn

from .model import HANDS, STREAMS, State

INPUTS = ["features", "visible", "reset", "streams", "token", "pose", "trajectory"]
OUTPUTS = ["rotation", "root", "contact", "streams_next", "token_next", "pose_next",
           "trajectory_next"]


class Step(nn.Module):
    """`HmdNemo` for one frame, with flags as floats (1 yes, 0 no)."""

    def __init__(self, model):
        super().__init__()
        self.model = model

    def forward(self, features, visible, reset, streams, token, pose, trajectory):
        model = self.model
        embedded = model.embedding(features)
        first = torch.tanh(model.initial(embedded[:1].expand(STREAMS, -1, -1)))
        hidden = reset * first + (1 - reset) * streams
        token = reset * model.first_token + (1 - reset) * token
        seen = visible[0, [0, 1, 0, 1]].view(HANDS, 1, 1) > 0.5
        hidden, tokens = model.encode_frame(embedded, hidden, seen, token)
        token, _ = model.next_token(tokens)
        state = State(hidden, token, pose, trajectory)
        out, _, pose, trajectory = model.decode(tokens.unsqueeze(2), state, reset.view(1, 1) > 0.5)
        return (out["local"][:, 0], out["root"][:, 0], torch.sigmoid(out["contact"][:, 0]),
                hidden, token, pose, trajectory)


def example_inputs(model):
    """A first frame: zeros, both hands seen, reset."""
    state = model.initial_state(1)
    return (torch.zeros(1, STREAMS, 15), torch.ones(1, 2), torch.ones(1), *state.tensors())
