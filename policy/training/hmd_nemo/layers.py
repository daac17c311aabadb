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


class GruScan(torch.autograd.Function):
    """A GRU over time with its gradient by hand.

    Autograd would record some thirty small operations a frame and add up the weight gradients
    frame by frame; here a frame costs eight operations forward and three backward, and the weight
    gradients are one product at the end.
    """

    @staticmethod
    def forward(ctx, from_input, hidden, weight, bias):
        """from_input (G, T, B, 3H) in gate order r, z, n; hidden (G, B, H). Returns (G, T, B, H)."""
        size = hidden.shape[-1]
        states, gates, news, hidden_news = [], [], [], []
        start = hidden
        for t in range(from_input.shape[1]):
            given = from_input[:, t]
            kept = torch.baddbmm(bias, hidden, weight)
            gate = (given[..., : 2 * size] + kept[..., : 2 * size]).sigmoid_()
            hidden_new = kept[..., 2 * size :]
            new = torch.addcmul(given[..., 2 * size :], gate[..., :size], hidden_new).tanh_()
            hidden = torch.lerp(new, hidden, gate[..., size:])
            states.append(hidden)
            gates.append(gate)
            news.append(new)
            hidden_news.append(hidden_new)
        out = torch.stack(states, 1)
        ctx.save_for_backward(
            start, weight, out, torch.stack(gates, 1), torch.stack(news, 1),
            torch.stack(hidden_news, 1),
        )
        return out

    @staticmethod
    def backward(ctx, grad):
        start, weight, out, gates, news, hidden_news = ctx.saved_tensors
        size = start.shape[-1]
        reset, keep = gates[..., :size], gates[..., size:]
        before = torch.cat([start.unsqueeze(1), out[:, :-1]], 1)
        new_slope = (1 - keep) * (1 - news * news)
        slopes = torch.cat([
            new_slope * hidden_news * reset * (1 - reset),
            (before - news) * keep * (1 - keep),
            new_slope * reset,
        ], -1)
        transposed = weight.transpose(1, 2).contiguous()
        arriving, leaving = [], []
        back = torch.zeros_like(start)
        for t in range(out.shape[1] - 1, -1, -1):
            total = grad[:, t] + back
            kept = (slopes[:, t].unflatten(-1, (3, size)) * total.unsqueeze(-2)).flatten(-2)
            back = torch.baddbmm(total * keep[:, t], kept, transposed)
            arriving.append(total)
            leaving.append(kept)
        total = torch.stack(arriving[::-1], 1)
        kept = torch.stack(leaving[::-1], 1)
        given = torch.cat([kept[..., : 2 * size], total * new_slope], -1)
        flat = kept.flatten(1, 2)
        grad_weight = before.flatten(1, 2).transpose(1, 2) @ flat
        return given, back, grad_weight, flat.sum(1, keepdim=True)


class GroupedGru(nn.Module):
    """`groups` GRU cells (Cho et al. 2014, PyTorch's gate order r, z, n)."""

    def __init__(self, groups, inputs, hidden):
        super().__init__()
        self.from_input = GroupedLinear(groups, inputs, 3 * hidden)
        self.from_hidden = GroupedLinear(groups, hidden, 3 * hidden)

    def forward(self, x, hidden):
        """One frame: x (groups, B, inputs), hidden (groups, B, hidden) to the new hidden."""
        xr, xz, xn = self.from_input(x).chunk(3, -1)
        hr, hz, hn = self.from_hidden(hidden).chunk(3, -1)
        keep = torch.sigmoid(xz + hz)
        new = torch.tanh(xn + torch.sigmoid(xr + hr) * hn)
        return new + keep * (hidden - new)

    def scan(self, x, hidden):
        """A sequence: x (groups, T, B, inputs) to the hidden states (groups, T, B, hidden)."""
        layer = self.from_hidden
        return GruScan.apply(self.from_input(x), hidden, layer.weight, layer.bias)


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
