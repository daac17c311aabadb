"""The five recurrent networks of PIP (Yi et al. 2022, section 3.1) and the two that begin them.

P_L gives leaf joint positions, P_A all joint positions, R_A rotations, V_A velocities, C_F foot
contact; I_PL and I_VA turn a known pose into the first memory of P_L and V_A.
"""

from dataclasses import dataclass

import torch
from torch import nn
from torch.nn import functional as F

from .lanes import LEAVES, REDUCED
from .sensors import INPUTS

LEAF_SIZE = 3 * len(LEAVES)
JOINT_SIZE = 63
VELOCITY_SIZE = 66
ROTATION_SIZE = 6 * len(REDUCED)
LAYERS = 2
VELOCITY_SCALE = 3.0
"""The network's answer times this is head heights a second (PIP's vel_scale)."""


@dataclass(frozen=True)
class Config:
    """Widths; the default is PIP's. Without `initial` the memory of P_L and V_A begins at zero."""

    hidden: int = 256
    contact: int = 64
    initial: bool = True


CONFIGS = {
    "full": Config(),
    "small": Config(hidden=160),
    "tiny": Config(hidden=16, contact=8),
}


class Recurrent(nn.Module):
    """Linear, ReLU, two LSTM layers, linear."""

    def __init__(self, inputs, hidden, outputs):
        super().__init__()
        self.enter = nn.Linear(inputs, hidden)
        self.lstm = nn.LSTM(hidden, hidden, LAYERS)
        self.leave = nn.Linear(hidden, outputs)
        for layer in range(LAYERS):
            # Remember by default.
            getattr(self.lstm, f"bias_ih_l{layer}").data[hidden : 2 * hidden] = 1.0

    def forward(self, x, state):
        """x (T, B, inputs), state a pair of (2, B, hidden); the same back."""
        x, state = self.lstm(F.relu(self.enter(x)), state)
        return self.leave(x), state


class Initial(nn.Module):
    """The first memory of a recurrent network from what is known of the first pose."""

    def __init__(self, inputs, hidden):
        super().__init__()
        self.hidden = hidden
        self.layers = nn.Sequential(
            nn.Linear(inputs, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU(),
            nn.Linear(hidden, 2 * LAYERS * hidden),
        )

    def forward(self, x):
        """x (B, inputs) to a pair of (2, B, hidden)."""
        both = self.layers(x).view(len(x), 2, LAYERS, self.hidden).permute(1, 2, 0, 3)
        return both[0].contiguous(), both[1].contiguous()


NETWORKS = ["leaves", "joints", "rotations", "velocities", "contact"]


class Pip(nn.Module):
    """All of them. The state is a dict of pairs (2, B, hidden) by network."""

    def __init__(self, config):
        super().__init__()
        self.config = config
        h = config.hidden
        self.leaves = Recurrent(INPUTS, h, LEAF_SIZE)
        self.joints = Recurrent(INPUTS + LEAF_SIZE, h, JOINT_SIZE)
        self.rotations = Recurrent(INPUTS + JOINT_SIZE, h, ROTATION_SIZE)
        self.velocities = Recurrent(INPUTS + JOINT_SIZE, h, VELOCITY_SIZE)
        self.contact = Recurrent(INPUTS + JOINT_SIZE, config.contact, 2)
        if config.initial:
            self.begin_leaves = Initial(LEAF_SIZE, h)
            self.begin_velocities = Initial(VELOCITY_SIZE, h)

    def initial_state(self, batch):
        """Zeros."""
        sizes = {n: self.config.contact if n == "contact" else self.config.hidden for n in NETWORKS}
        zero = {n: torch.zeros(LAYERS, batch, size) for n, size in sizes.items()}
        return {n: (z, z.clone()) for n, z in zero.items()}

    def begin(self, leaves, velocities):
        """The memory for a wearer whose first pose is known: (B, 15) and (B, 66)."""
        state = self.initial_state(len(leaves))
        if self.config.initial:
            state["leaves"] = self.begin_leaves(leaves)
            state["velocities"] = self.begin_velocities(velocities / VELOCITY_SCALE)
        else:
            # An exported step keeps the inputs that it does not need.
            nothing = 0 * (leaves.sum() + velocities.sum())
            state["leaves"] = tuple(part + nothing for part in state["leaves"])
        return state

    def forward(self, x, state):
        """x (B, T, 72). Each network sees the answer of the one before, without gradient: the
        five are trained for themselves, as PIP's are, but on what they will be given."""
        x = x.transpose(0, 1)
        after = {}
        leaves, after["leaves"] = self.leaves(x, state["leaves"])
        x_leaves = torch.cat([leaves.detach(), x], -1)
        joints, after["joints"] = self.joints(x_leaves, state["joints"])
        x_joints = torch.cat([joints.detach(), x], -1)
        rotations, after["rotations"] = self.rotations(x_joints, state["rotations"])
        velocities, after["velocities"] = self.velocities(x_joints, state["velocities"])
        contact, after["contact"] = self.contact(x_joints, state["contact"])
        out = {
            "leaves": leaves, "joints": joints, "rotations": rotations,
            "velocities": velocities * VELOCITY_SCALE, "contact": contact,
        }
        return {n: v.transpose(0, 1) for n, v in out.items()}, after


def select(reset, fresh, kept):
    """The fresh memory where `reset` (B,) bool, else the kept one without its gradient."""
    choice = reset[None, :, None]
    return {
        n: tuple(torch.where(choice, f, k.detach()) for f, k in zip(fresh[n], kept[n]))
        for n in kept
    }
