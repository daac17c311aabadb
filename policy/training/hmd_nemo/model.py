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
        """Encoder tokens (5, B, hidden) to (4, B, width)."""
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
        self.decoder_gru = GroupedGru(1, config.decoder, config.decoder)
        self.decoder_mid = nn.Linear(2 * config.decoder, config.decoder)
        self.pose = nn.Linear(config.decoder, JOINTS * 6)
        self.contact = nn.Linear(config.decoder, CONTACTS)
        self.trajectory_in = nn.Linear(STREAMS * d, config.trajectory)
        self.trajectory_gru = GroupedGru(1, config.trajectory, config.trajectory)
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

    def spatial(self, x, hidden):
        """Transformer over the streams: x and GRU states (5, ..., w) to tokens (5, ..., d)."""
        tokens = (hidden + self.skip(x)).flatten(1, -2).transpose(0, 1)
        for layer in self.layers:
            tokens = layer(tokens)
        return self.norm(tokens).transpose(0, 1).unflatten(1, x.shape[1:-1])

    def encode_frame(self, embedded, hidden, seen, previous):
        """One frame of the encoder: embedded (5, B, w), previous mask tokens (4, B, w)."""
        x = torch.cat([embedded[:1], torch.where(seen, embedded[1:], previous)])
        hidden = self.gru(x, hidden)
        return hidden, self.spatial(x, hidden)

    def next_token(self, tokens):
        """Mask tokens for the next frame from encoder tokens (5, B, d)."""
        if self.mask_tokens is None:
            return self.first_token.expand(-1, tokens.shape[1], -1)
        return self.mask_tokens.token(self.mask_tokens.features(tokens))

    @torch.no_grad()
    def roll_out(self, embedded, seen, hidden, token):
        """Encoder tokens (5, T, B, d) frame by frame, with the mask tokens fed back."""
        out = []
        for t in range(embedded.shape[1]):
            hidden, tokens = self.encode_frame(embedded[:, t], hidden, seen[:, t], token)
            token = self.next_token(tokens)
            out.append(tokens)
        return torch.stack(out, 1)

    def masks(self, embedded, seen, hidden, token):
        """Mask tokens (4, T, B, w) for frames whose hands are not seen.

        They depend on the encoder's own past. The past is rolled out first, without gradients;
        then all tokens are made from it at once. So their values are exact, and their gradients
        train the token network but do not run further back through time.
        """
        if self.mask_tokens is None:
            return self.first_token.unsqueeze(1).expand_as(embedded[1:])
        lanes = (~seen).flatten(0, 1).any(0).squeeze(-1).nonzero().squeeze(1)
        masks = torch.zeros_like(embedded[1:])
        if len(lanes) == 0:
            return masks
        past = self.roll_out(embedded[:, :, lanes].detach(), seen[:, :, lanes],
                             hidden[:, lanes].detach(), token[:, lanes].detach())
        flat = past[:, :-1].flatten(1, 2)
        later = self.next_token(flat).unflatten(1, past[:, :-1].shape[1:3])
        return masks.index_copy(2, lanes, torch.cat([token[:, lanes].unsqueeze(1), later], 1))

    def decode(self, joined, state, reset):
        """Joined tokens (T, B, 5 d) to the outputs (T, B, ...) and the decoders' new states."""
        x = F.leaky_relu(self.decoder_in(joined))
        first = torch.tanh(self.decoder_initial(joined[0]))
        start = torch.where(reset, first, state.pose)
        memory = self.decoder_gru.scan(x.unsqueeze(0), start.unsqueeze(0))[0]
        start = torch.where(reset, torch.zeros_like(state.trajectory), state.trajectory)
        path = F.leaky_relu(self.trajectory_in(joined)).unsqueeze(0)
        path = self.trajectory_gru.scan(path, start.unsqueeze(0))[0]
        return self.answer(x, memory, path), memory[-1], path[-1]

    def answer(self, x, memory, path):
        """The heads' outputs from the decoders' inputs and states."""
        mid = F.leaky_relu(self.decoder_mid(torch.cat([memory, x], -1)))
        six = self.pose(mid).unflatten(-1, (JOINTS, 6))
        return {"six": six, "local": six_to_matrix(six), "contact": self.contact(mid),
                "root": self.trajectory(path)}

    def forward(self, features, visible, state, reset):
        """features (B, T, 5, 15), visible (B, T, 2) bool, reset (B, 1) bool: start afresh at the
        first frame. Returns the outputs by name, (B, T, ...), and the state after the last frame.
        """
        embedded = self.embedding(features.transpose(0, 1))
        seen = visible[..., [0, 1, 0, 1]].permute(2, 1, 0).unsqueeze(-1)
        first = self.initial(embedded[:1, 0].expand(STREAMS, -1, -1))
        hidden = torch.where(reset, torch.tanh(first), state.streams)
        token = torch.where(reset, self.first_token, state.token)
        hands = torch.where(seen, embedded[1:], self.masks(embedded, seen, hidden, token))
        x = torch.cat([embedded[:1], hands])
        states = self.gru.scan(x, hidden)
        tokens = self.spatial(x, states)
        joined = tokens.permute(1, 2, 0, 3).flatten(2)
        out, pose, trajectory = self.decode(joined, state, reset)
        if self.training:
            out["auxiliary"] = self.auxiliary(joined).unflatten(-1, (JOINTS, 9))
            if self.mask_tokens is not None:
                base = self.mask_tokens.features(tokens.flatten(1, 2))
                forecast = self.mask_tokens.forecasts(base).unflatten(1, tokens.shape[1:3])
                out["forecast"] = forecast.permute(1, 2, 0, 3)
        out = {name: value.transpose(0, 1) for name, value in out.items()}
        return out, State(states[:, -1], self.next_token(tokens[:, -1]), pose, trajectory)
