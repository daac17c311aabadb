"""The network as one frame: what is exported. State in, state out, batch 1, no control flow."""

import torch
from torch import nn
from torch.nn import functional as F

from .model import HANDS, STREAMS

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
        joined = tokens.permute(1, 0, 2).flatten(1)
        first = torch.tanh(model.decoder_initial(joined))
        x = F.leaky_relu(model.decoder_in(joined)).unsqueeze(0)
        pose = model.decoder_gru(x, (reset * first + (1 - reset) * pose).unsqueeze(0))[0]
        path = F.leaky_relu(model.trajectory_in(joined)).unsqueeze(0)
        trajectory = model.trajectory_gru(path, ((1 - reset) * trajectory).unsqueeze(0))[0]
        out = model.answer(x[0], pose, trajectory)
        return (out["local"], out["root"], torch.sigmoid(out["contact"]),
                hidden, model.next_token(tokens), pose, trajectory)


def example_inputs(model):
    """A first frame: zeros, both hands seen, reset."""
    state = model.initial_state(1)
    return (torch.zeros(1, STREAMS, 15), torch.ones(1, 2), torch.ones(1), *state.tensors())
