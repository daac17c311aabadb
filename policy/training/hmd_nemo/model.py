"""The network: embeddings, five GRUs, spatial transformer, adaptable mask tokens, decoders.

Follows the supplement of HMD-NeMo (Aliakbarian et al., ICCV 2023). FEATURES.md says where it
departs and why.
"""

from dataclasses import dataclass

import torch
from torch import nn
from torch.nn import functional as F

from posed_mocap.rotations import six_to_matrix
from posed_mocap.skeleton import JOINTS

from .features import STREAMS
from .layers import GroupedGru, GroupedLinear, SpatialLayer

HANDS = 4
CONTACTS = 4


@dataclass(frozen=True)
class Config:
    """Widths. `tamt` False replaces the adaptable mask tokens by learned, fixed ones."""

    embed: int = 32
    hidden: int = 256
    layers: int = 4
    heads: int = 4
    feedforward: int = 512
    token: int = 256
    decoder: int = 256
    trajectory: int = 64
    tamt: bool = True


CONFIGS = {
    "full": Config(),
    "small": Config(embed=24, hidden=96, layers=2, feedforward=192, token=96, decoder=256),
    "tiny": Config(embed=4, hidden=16, layers=1, heads=2, feedforward=16, token=8, decoder=16,
                   trajectory=8),
}


class Embedding(nn.Module):
    """Rotation, position and their velocities of each stream, each by its own layer (Eq. 3)."""

    def __init__(self, size):
        super().__init__()
        self.parts = nn.ModuleList(GroupedLinear(STREAMS, n, size) for n in (6, 3, 3, 3))
        self.register_buffer("scale", torch.tensor([1.0] * 9 + [0.2] * 3 + [1.0] * 3))

    def forward(self, features):
        """(..., 5, 15) to (5, ..., 4 * size)."""
        split = (features * self.scale).movedim(features.dim() - 2, 0).split((6, 3, 3, 3), -1)
        return torch.cat([F.leaky_relu(layer(x)) for layer, x in zip(self.parts, split)], -1)


class MaskTokens(nn.Module):
    """TAMT: from a hand's and the head's features at t, a token for t + 1, and a forecast."""

    def __init__(self, config):
        super().__init__()
        width = config.token
        self.base = nn.ModuleList([
            GroupedLinear(HANDS, 2 * config.hidden, width), GroupedLinear(HANDS, width, width),
        ])
        self.to_token = GroupedLinear(HANDS, width, 4 * config.embed)
        self.forecast = nn.ModuleList([
            GroupedLinear(HANDS, width, width), GroupedLinear(HANDS, width, 9),
        ])

    def features(self, tokens):
        """tokens (5, B, hidden) to (4, B, width)."""
        x = torch.cat([tokens[:1].expand(HANDS, -1, -1), tokens[1:]], -1)
        for layer in self.base:
            x = F.leaky_relu(layer(x))
        return x

    def token(self, x):
        return F.leaky_relu(self.to_token(x))

    def forecasts(self, x):
        return self.forecast[1](F.leaky_relu(self.forecast[0](x)))


@dataclass
class State:
    """What a frame hands to the next. All start at zero; `reset` makes the first frame's."""

    streams: torch.Tensor
    token: torch.Tensor
    pose: torch.Tensor
    trajectory: torch.Tensor

    def detach(self):
        return State(*(t.detach() for t in self.tensors()))

    def tensors(self):
        return self.streams, self.token, self.pose, self.trajectory


class HmdNemo(nn.Module):
    """Five streams in; local rotations, pelvis position and foot contacts out."""

    def __init__(self, config):
        super().__init__()
        self.config = config
        d, width = config.hidden, 4 * config.embed
        self.embedding = Embedding(config.embed)
        self.initial = GroupedLinear(STREAMS, width, d)
        self.gru = GroupedGru(STREAMS, width, d)
        self.skip = GroupedLinear(STREAMS, width, d)
        self.layers = nn.ModuleList(
            SpatialLayer(d, config.heads, config.feedforward) for _ in range(config.layers)
        )
        self.norm = nn.LayerNorm(d)
        self.first_token = nn.Parameter(torch.randn(HANDS, 1, width) * 0.1)
        self.mask_tokens = MaskTokens(config) if config.tamt else None
        self.decoder_in = nn.Linear(STREAMS * d, config.decoder)
        self.decoder_initial = nn.Linear(STREAMS * d, config.decoder)
        self.decoder_gru = nn.GRU(config.decoder, config.decoder, batch_first=True)
        self.decoder_mid = nn.Linear(2 * config.decoder, config.decoder)
        self.pose = nn.Linear(config.decoder, JOINTS * 6)
        self.contact = nn.Linear(config.decoder, CONTACTS)
        self.trajectory_in = nn.Linear(STREAMS * d, config.trajectory)
        self.trajectory_gru = nn.GRU(config.trajectory, config.trajectory, batch_first=True)
        self.trajectory = nn.Linear(config.trajectory, 3)
        self.auxiliary = nn.Linear(STREAMS * d, JOINTS * 9)
        with torch.no_grad():
            self.pose.weight.mul_(0.1)
            self.pose.bias.copy_(torch.tensor([1.0, 0, 0, 0, 1, 0]).repeat(JOINTS))

    def initial_state(self, batch):
        c = self.config
        zeros = next(self.parameters()).new_zeros
        return State(zeros(STREAMS, batch, c.hidden), zeros(HANDS, batch, 4 * c.embed),
                     zeros(batch, c.decoder), zeros(batch, c.trajectory))

    def encode_frame(self, embedded, hidden, seen, previous):
        """One frame of the encoder: (5, B, w) to the new GRU state and tokens (5, B, d)."""
        hands = torch.where(seen, embedded[1:], previous)
        x = torch.cat([embedded[:1], hands])
        hidden = self.gru(x, hidden)
        tokens = (hidden + self.skip(x)).transpose(0, 1)
        for layer in self.layers:
            tokens = layer(tokens)
        tokens = self.norm(tokens).transpose(0, 1)
        return hidden, tokens

    def next_token(self, tokens):
        """Mask tokens for the next frame, and the features they are made from."""
        if self.mask_tokens is None:
            return self.first_token.expand(-1, tokens.shape[1], -1), None
        base = self.mask_tokens.features(tokens)
        return self.mask_tokens.token(base), base

    def decode(self, tokens, state, reset):
        """Tokens (5, B, T, d) to the outputs and the decoders' new states."""
        joined = tokens.permute(1, 2, 0, 3).flatten(2)
        x = F.leaky_relu(self.decoder_in(joined))
        first = torch.tanh(self.decoder_initial(joined[:, 0]))
        start = torch.where(reset, first, state.pose)
        memory, pose_state = self.decoder_gru(x, start.unsqueeze(0))
        mid = F.leaky_relu(self.decoder_mid(torch.cat([memory, x], -1)))
        path, path_state = self.trajectory_gru(
            F.leaky_relu(self.trajectory_in(joined)),
            torch.where(reset, torch.zeros_like(state.trajectory), state.trajectory).unsqueeze(0),
        )
        out = {
            "six": self.pose(mid).unflatten(-1, (JOINTS, 6)),
            "contact": self.contact(mid),
            "root": self.trajectory(path),
        }
        out["local"] = six_to_matrix(out["six"])
        return out, joined, pose_state[0], path_state[0]

    def forward(self, features, visible, state, reset):
        """features (B, T, 5, 15), visible (B, T, 2) bool, reset (B, 1) bool: start afresh at the
        first frame. Returns the outputs by name, (B, T, ...), and the state after the last frame.
        """
        embedded = self.embedding(features).unbind(2)
        seen = visible[..., [0, 1, 0, 1]].permute(1, 2, 0).unsqueeze(-1)
        hidden = torch.where(
            reset, torch.tanh(self.initial(embedded[0][:1].expand(STREAMS, -1, -1))), state.streams
        )
        token = torch.where(reset, self.first_token, state.token)
        frames, bases = [], []
        for t, frame in enumerate(embedded):
            hidden, tokens = self.encode_frame(frame, hidden, seen[t], token)
            token, base = self.next_token(tokens)
            frames.append(tokens)
            bases.append(base)
        out, joined, pose, trajectory = self.decode(torch.stack(frames, 2), state, reset)
        if self.training:
            out["auxiliary"] = self.auxiliary(joined).unflatten(-1, (JOINTS, 9))
            if self.mask_tokens is not None:
                base = torch.stack(bases, 2).flatten(1, 2)
                forecast = self.mask_tokens.forecasts(base)
                out["forecast"] = forecast.unflatten(1, visible.shape[:2]).permute(1, 2, 0, 3)
        return out, State(hidden, token, pose, trajectory)
