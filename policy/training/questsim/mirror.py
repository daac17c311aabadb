"""The character's mirror image in the sagittal plane (x becomes -x), of observations and torques.

The character is the same on both sides, and so what is right for a state is right, mirrored, for its
mirror image: every answer teaches twice, and a policy can be asked of both (`Symmetric`).
"""

import numpy as np
import torch
from torch import nn

from .observation import FUTURE, SIZE

LIMBS = ((4, 7), (5, 8), (6, 9), (10, 13), (11, 14), (12, 15))
"""Links of the left and of the right."""
HINGES = np.concatenate([np.arange(9), np.arange(15, 21), np.arange(9, 15), np.arange(27, 33),
                         np.arange(21, 27)])
"""Each hinge's counterpart: nine of the trunk, six of each arm, six of each leg."""
TURNS = np.concatenate([np.tile([1.0, -1.0, -1.0], 3), np.ones(24)])
"""The trunk bends sideways and twists the other way; axes of limbs are each other's image."""
VECTOR = np.array([-1.0, 1.0, 1.0])
AXIAL = -VECTOR
"""Angular velocities, and the first column of a rotation."""
COLUMNS = np.concatenate([AXIAL, VECTOR])
"""The first two columns of a rotation."""


def links():
    """(16,) each link's counterpart."""
    counterpart = np.arange(16)
    for left, right in LIMBS:
        counterpart[[left, right]] = right, left
    return counterpart


def observation():
    """(475,) of which number each number is the mirror image, and its sign."""
    index, sign = [HINGES, 33 + HINGES], [TURNS, TURNS]
    begin = 66
    for order, pattern in [(links(), VECTOR), (links(), COLUMNS), ([1, 0], VECTOR),
                           (links(), VECTOR), (links(), AXIAL)]:
        width = len(pattern)
        for part in order:
            index.append(begin + width * part + np.arange(width))
            sign.append(pattern)
        begin += width * len(order)
    pattern = np.concatenate([VECTOR, COLUMNS])
    for frame in range(FUTURE):
        for part in (0, 2, 1):
            index.append(begin + 9 * (3 * frame + part) + np.arange(9))
            sign.append(pattern)
    index, sign = np.concatenate([*index, [SIZE - 1]]), np.concatenate([*sign, [1.0]])
    return index, sign


class Mirror(nn.Module):
    """Mirrors observations (n, 475) and actions (n, 33)."""

    def __init__(self):
        super().__init__()
        for name, (index, sign) in (("seen", observation()), ("done", (HINGES, TURNS))):
            self.register_buffer(f"{name}_index", torch.from_numpy(index))
            self.register_buffer(f"{name}_sign", torch.from_numpy(sign).float())

    def observation(self, seen):
        return seen[:, self.seen_index] * self.seen_sign

    def action(self, action):
        return action[:, self.done_index] * self.done_sign


class Symmetric(nn.Module):
    """A student asked of what it sees and of the mirror image: the mean of both answers."""

    def __init__(self, student):
        super().__init__()
        self.student, self.mirror = student, Mirror()

    def forward(self, seen):
        both = self.student(torch.cat([seen, self.mirror.observation(seen)]))
        return 0.5 * (both[:len(seen)] + self.mirror.action(both[len(seen):]))
