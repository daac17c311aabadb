"""AvatarPoser's architecture (Jiang et al., ECCV 2022), for comparison on the same data and loop.

A linear embedding of the last 40 frames, a 3-layer transformer encoder over time, its last token
to a global-orientation MLP and a joint-rotation MLP. The published inputs (6D rotation, its
change, position, its change, for head and hands: 54 numbers in the world) are the first three
streams here, in the heading frame so that both models see the same. Its inverse kinematics stage
is left out, as its hands always need to be seen. Hands that are not seen are zeros with a flag.
"""

from dataclasses import dataclass

import torch
from torch import nn

from posed_mocap.rotations import six_to_matrix
from posed_mocap.skeleton import JOINTS

from .features import STREAM_SIZE


@dataclass(frozen=True)
class AvatarPoserConfig:
    """The published widths."""

    window: int = 40
    width: int = 256
    heads: int = 8
    layers: int = 3
    feedforward: int = 2048


@dataclass
class Window:
    """The state between chunks: the inputs of the last `window - 1` frames."""

    inputs: torch.Tensor

    def detach(self):
        return self

    def tensors(self):
        return (self.inputs,)


class AvatarPoser(nn.Module):
    """Same call as `HmdNemo`, but in training only the last two frames of a chunk are predicted:
    every predicted frame costs a pass over a whole window."""

    def __init__(self, config):
        super().__init__()
        self.config = config
        self.embed = nn.Linear(3 * STREAM_SIZE + 2, config.width)
        layer = nn.TransformerEncoderLayer(
            config.width, config.heads, config.feedforward, dropout=0.0, batch_first=True
        )
        self.encoder = nn.TransformerEncoder(layer, config.layers, enable_nested_tensor=False)
        self.orientation = nn.Sequential(
            nn.Linear(config.width, 256), nn.ReLU(), nn.Linear(256, 6)
        )
        self.body = nn.Sequential(
            nn.Linear(config.width, 256), nn.ReLU(), nn.Linear(256, (JOINTS - 1) * 6)
        )
        with torch.no_grad():
            for head, joints in ((self.orientation, 1), (self.body, JOINTS - 1)):
                head[2].weight.mul_(0.1)
                head[2].bias.copy_(torch.tensor([1.0, 0, 0, 0, 1, 0]).repeat(joints))

    def last(self, window):
        """The encoder's last token (B, width) of embedded windows (B, N, width): of its last layer
        nothing else is computed."""
        *layers, layer = self.encoder.layers
        for each in layers:
            window = each(window)
        token = window[:, -1:]
        seen = layer.self_attn(token, window, window, need_weights=False)[0]
        token = layer.norm1(token + seen)
        return layer.norm2(token + layer.linear2(layer.linear1(token).relu()))[:, 0]

    def initial_state(self, batch):
        width = 3 * STREAM_SIZE + 2
        return Window(next(self.parameters()).new_zeros(batch, self.config.window - 1, width))

    def forward(self, features, visible, state, reset):
        """Each frame from the window that ends there."""
        inputs = torch.cat([features[:, :, :3].flatten(2), visible.float()], -1)
        before = torch.where(reset.unsqueeze(-1), inputs[:, :1], state.inputs)
        stream = torch.cat([before, inputs], 1)
        x = self.embed(stream).unfold(1, self.config.window, 1).transpose(-1, -2)
        if self.training:
            x = x[:, -2:]
        last = self.last(x.flatten(0, 1)).unflatten(0, x.shape[:2])
        six = torch.cat([self.orientation(last), self.body(last)], -1).unflatten(-1, (JOINTS, 6))
        out = {"six": six, "local": six_to_matrix(six)}
        return out, Window(stream[:, -(self.config.window - 1):].detach())


class WindowStep(nn.Module):
    """`AvatarPoser` for one frame with the inputs and outputs of HMD-NeMo's step, so that `posed
    eval --model` takes it: the window is the state `pose`, the other states are idle, the pelvis
    and foot contacts are not estimated."""

    def __init__(self, model):
        super().__init__()
        self.model = model

    def example_inputs(self):
        """A first frame: zeros, both hands seen, reset."""
        window = self.model.initial_state(1).inputs.flatten(1)
        return (torch.zeros(1, 5, STREAM_SIZE), torch.ones(1, 2), torch.ones(1),
                torch.zeros(5, 1, 1), torch.zeros(4, 1, 1), window, torch.zeros(1, 1))

    def forward(self, features, visible, reset, streams, token, pose, trajectory):
        model = self.model
        now = torch.cat([features[:, :3].flatten(1), visible], -1).unsqueeze(1)
        kept = pose.unflatten(-1, (model.config.window - 1, 3 * STREAM_SIZE + 2))
        window = torch.cat([reset * now + (1 - reset) * kept, now], 1)
        last = model.last(model.embed(window))
        six = torch.cat([model.orientation(last), model.body(last)], -1)
        local = six_to_matrix(six.unflatten(-1, (JOINTS, 6)))
        none = visible[:, :1] * 0
        return (local, none.expand(1, 3), none.expand(1, 4), streams * 1, token * 1,
                window[:, 1:].flatten(1), trajectory * 1)
