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
        groups, frames, batch, _ = from_input.shape
        size = hidden.shape[-1]
        new_buffer = from_input.new_empty
        out = new_buffer(groups, frames, batch, size)
        gates = new_buffer(groups, frames, batch, 2 * size)
        news, hidden_news = torch.empty_like(out), torch.empty_like(out)
        start = hidden
        for t in range(frames):
            given = from_input[:, t]
            kept = torch.baddbmm(bias, hidden, weight)
            gate, new = gates[:, t], news[:, t]
            torch.add(given[..., : 2 * size], kept[..., : 2 * size], out=gate).sigmoid_()
            hidden_news[:, t] = kept[..., 2 * size :]
            torch.addcmul(given[..., 2 * size :], gate[..., :size], hidden_news[:, t], out=new)
            new.tanh_()
            hidden = torch.lerp(new, hidden, gate[..., size:], out=out[:, t])
        ctx.save_for_backward(start, weight, out, gates, news, hidden_news)
        return out

    @staticmethod
    def backward(ctx, grad):
        start, weight, out, gates, news, hidden_news = ctx.saved_tensors
        size, frames = start.shape[-1], out.shape[1]
        reset, keep = gates[..., :size], gates[..., size:]
        before = torch.cat([start.unsqueeze(1), out[:, :-1]], 1)
        new_slope = (1 - keep) * (1 - news * news)
        # What a unit of the state's gradient gives each gate's sum from the hidden side.
        kept = out.new_empty(*out.shape[:3], 3, size)
        torch.mul(new_slope, reset, out=kept[..., 2, :])
        torch.mul(kept[..., 2, :], hidden_news * (1 - reset), out=kept[..., 0, :])
        torch.mul((before - news) * keep, 1 - keep, out=kept[..., 1, :])
        transposed = weight.transpose(1, 2).contiguous()
        total = torch.empty_like(out)
        back = torch.zeros_like(start)
        for t in range(frames - 1, -1, -1):
            torch.add(grad[:, t], back, out=total[:, t])
            kept[:, t] *= total[:, t].unsqueeze(-2)
            back = torch.baddbmm(total[:, t] * keep[:, t], kept[:, t].flatten(-2), transposed)
        flat = kept.flatten(-2).flatten(1, 2)
        grad_weight = before.flatten(1, 2).transpose(1, 2) @ flat
        grad_bias = flat.sum(1, keepdim=True)
        torch.mul(total, new_slope, out=kept[..., 2, :])
        return kept.flatten(-2), back, grad_weight, grad_bias


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
