"""Layers for several streams at once: one batched product instead of a module per stream."""

import torch
from torch import nn
from torch.nn import functional as F


class GroupedLinear(nn.Module):
    """`groups` independent linear layers on (groups, ..., inputs)."""

    def __init__(self, groups, inputs, outputs):
        super().__init__()
        bound = inputs**-0.5
        self.weight = nn.Parameter(torch.empty(groups, inputs, outputs).uniform_(-bound, bound))
        self.bias = nn.Parameter(torch.empty(groups, 1, outputs).uniform_(-bound, bound))

    def forward(self, x):
        if x.dim() == 3:
            return torch.baddbmm(self.bias, x, self.weight)
        return torch.baddbmm(self.bias, x.flatten(1, -2), self.weight).unflatten(1, x.shape[1:-1])


class GroupedGru(nn.Module):
    """`groups` GRU cells (Cho et al. 2014, PyTorch's gate order r, z, n) on (groups, B, inputs)."""

    def __init__(self, groups, inputs, hidden):
        super().__init__()
        self.from_input = GroupedLinear(groups, inputs, 3 * hidden)
        self.from_hidden = GroupedLinear(groups, hidden, 3 * hidden)

    def forward(self, x, hidden):
        xr, xz, xn = self.from_input(x).chunk(3, -1)
        hr, hz, hn = self.from_hidden(hidden).chunk(3, -1)
        keep = torch.sigmoid(xz + hz)
        new = torch.tanh(xn + torch.sigmoid(xr + hr) * hn)
        return new + keep * (hidden - new)


class SpatialLayer(nn.Module):
    """Pre-norm transformer layer over the five streams, (B, streams, width)."""

    def __init__(self, width, heads, feedforward):
        super().__init__()
        self.heads = heads
        self.norm_attention = nn.LayerNorm(width)
        self.qkv = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)
        self.norm_feedforward = nn.LayerNorm(width)
        self.up = nn.Linear(width, feedforward)
        self.down = nn.Linear(feedforward, width)

    def forward(self, x):
        q, k, v = self.qkv(self.norm_attention(x)).unflatten(-1, (3, self.heads, -1)).unbind(-3)
        q, k, v = (part.transpose(-2, -3) for part in (q, k, v))
        scores = (q @ k.transpose(-1, -2)) * q.shape[-1] ** -0.5
        mixed = (scores.softmax(-1) @ v).transpose(-2, -3).flatten(-2)
        x = x + self.out(mixed)
        return x + self.down(F.relu(self.up(self.norm_feedforward(x))))
