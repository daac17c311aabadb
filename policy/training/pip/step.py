"""The networks as one frame: what is exported. State in, state out, batch 1, no control flow."""

import torch
from torch import nn
from torch.nn import functional as F

from posed_mocap.rotations import six_to_matrix

from .lanes import REDUCED
from .model import JOINT_SIZE, LAYERS, LEAF_SIZE, NETWORKS, VELOCITY_SCALE, VELOCITY_SIZE
from .sensors import INPUTS as FEATURES

INPUTS = ["features", "reset", "first_leaves", "first_velocities", "state"]
OUTPUTS = ["rotations", "velocities", "contact", "joints", "state_next"]


def sizes(config):
    """Numbers of each network's state: (h, c) of both layers."""
    width = {n: config.contact if n == "contact" else config.hidden for n in NETWORKS}
    return [2 * LAYERS * width[n] for n in NETWORKS]


def pack(state):
    """The state dict of a model, batch 1, as one row."""
    return torch.cat([torch.stack(state[n]).reshape(1, -1) for n in NETWORKS], 1)


class Cell(nn.Module):
    """One frame of a `Recurrent`, written out: plain products run fastest frame by frame."""

    def __init__(self, recurrent):
        super().__init__()
        self.recurrent = recurrent

    def forward(self, x, state):
        lstm = self.recurrent.lstm
        x = F.relu(self.recurrent.enter(x))
        hidden, cell = state.view(2, LAYERS, -1).unbind(0)
        after = []
        for layer in range(LAYERS):
            before = hidden[layer : layer + 1]
            weights = torch.cat([getattr(lstm, f"weight_ih_l{layer}"),
                                 getattr(lstm, f"weight_hh_l{layer}")], 1)
            bias = getattr(lstm, f"bias_ih_l{layer}") + getattr(lstm, f"bias_hh_l{layer}")
            gates = F.linear(torch.cat([x, before], 1), weights, bias)
            enter, forget, value, leave = gates.chunk(4, 1)
            memory = torch.sigmoid(forget) * cell[layer : layer + 1]
            memory = memory + torch.sigmoid(enter) * torch.tanh(value)
            x = torch.sigmoid(leave) * torch.tanh(memory)
            after.append((x, memory))
        both = [part for pair in zip(*after) for part in pair]
        return self.recurrent.leave(x), torch.cat(both, 1)


class Step(nn.Module):
    """`Pip` for one frame. Where `reset` is 1 the memory is begun from the first pose."""

    def __init__(self, model):
        super().__init__()
        self.model = model
        self.cells = nn.ModuleDict({n: Cell(getattr(model, n)) for n in NETWORKS})

    def forward(self, features, reset, first_leaves, first_velocities, state):
        fresh = pack(self.model.begin(first_leaves, first_velocities))
        state = reset * fresh + (1 - reset) * state
        part = dict(zip(NETWORKS, state.split(sizes(self.model.config), 1)))
        after = {}
        leaves, after["leaves"] = self.cells["leaves"](features, part["leaves"])
        joints, after["joints"] = self.cells["joints"](
            torch.cat([leaves, features], 1), part["joints"])
        x = torch.cat([joints, features], 1)
        answers = {}
        for name in NETWORKS[2:]:
            answers[name], after[name] = self.cells[name](x, part[name])
        rotations = six_to_matrix(answers["rotations"].view(1, len(REDUCED), 6))
        velocities = (VELOCITY_SCALE * answers["velocities"]).view(1, VELOCITY_SIZE // 3, 3)
        return (rotations, velocities, torch.sigmoid(answers["contact"]),
                joints.view(1, JOINT_SIZE // 3, 3), torch.cat([after[n] for n in NETWORKS], 1))


def example_inputs(model):
    """A first frame: zeros, reset."""
    return (torch.zeros(1, FEATURES), torch.ones(1), torch.zeros(1, LEAF_SIZE),
            torch.zeros(1, VELOCITY_SIZE), torch.zeros(1, sum(sizes(model.config))))
