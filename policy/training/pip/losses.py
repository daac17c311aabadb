"""PIP's losses: distances for positions and rotations, cross-entropy for contact, and TransPose's
cumulative loss for velocities (Yi et al. 2021, section 3.2.2).

Distances take the place of their squares: they are what the metrics measure.
"""

from torch.nn import functional as F

WINDOWS = [1, 3, 9, 27]
WEIGHTS = {"leaves": 1.0, "joints": 1.0, "rotations": 1.0, "velocities": 1.0, "contact": 0.2}


def distance(answer, truth, size=3):
    """Mean length of the difference of vectors of `size` numbers."""
    return (answer - truth).unflatten(-1, (-1, size)).norm(dim=-1).mean()


def cumulative(answer, truth):
    """How far the way covered in windows of 1, 3, 9, 27 frames is off, as a velocity: the sums
    of the error over each window, less and less weight on longer ones so that all count alike."""
    error = (answer - truth).unflatten(-1, (-1, 3))
    total, frames, used = 0.0, error.shape[1], 0
    for window in WINDOWS:
        if window > frames:
            break
        count = frames // window
        way = error[:, : count * window].unflatten(1, (count, window)).sum(2)
        # A random error of one frame grows with the root of the window.
        total = total + way.norm(dim=-1).mean() / window**0.5
        used += 1
    return total / used


def losses(out, batch):
    """By network."""
    return {
        "leaves": distance(out["leaves"], batch.leaves),
        "joints": distance(out["joints"], batch.joints),
        "rotations": distance(out["rotations"], batch.rotations.flatten(2), 6),
        "velocities": cumulative(out["velocities"], batch.velocities),
        "contact": F.binary_cross_entropy_with_logits(out["contact"], batch.contact),
    }


def total(named):
    return sum(WEIGHTS[n] * v for n, v in named.items())
