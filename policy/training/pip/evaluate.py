"""Evaluates a checkpoint's kinematics on splits of the shared sets, without physics.

    python -m pip.evaluate --mocap DIR --checkpoint FILE --sets snu,hdm05 --splits test,cross
"""

import torch

from common import evaluate as command
from posed_mocap.rotations import geodesic, quat_to_matrix, six_to_matrix
from posed_mocap.skeleton import JOINTS, PARENTS

from . import motion
from .checkpoint import load_model
from .lanes import REDUCED, targets
from .sensors import JOINTS_OF, NoError, features, measure, usual_place

SIP = [1, 2, 16, 17]
CHUNK = 300
SMOOTHING = 4
EDGE = 5


def whole_clips(motions, clips, stride):
    """Features and truth of whole clips, padded with the last frame; frames of each too."""
    spans = [motions.frames(c) for c in clips]
    counts = torch.tensor([(b - a - 2 * EDGE - stride) // stride for a, b in spans])
    steps = torch.arange(int(counts.max())) * stride
    first = torch.tensor([a + EDGE + stride for a, _ in spans])
    last = first + (counts - 1) * stride
    index = torch.minimum(first[:, None] + steps, last[:, None])
    height = motions.height[list(clips)]
    seconds = torch.full((len(clips),), 2 / motion.RATE)
    truth = targets(motions, index, index - 1, index + 1, seconds, height)
    start = (first - stride)[:, None]
    begin = targets(motions, start, start - 1, start + 1, seconds, height)
    taps = (index.unsqueeze(-1) + SMOOTHING * torch.tensor([-1, 0, 1])).unsqueeze(-1)
    turns = motions.turns[taps, torch.tensor(JOINTS_OF)].float()
    turns = turns / turns.norm(dim=-1, keepdim=True)
    places = motions.places[taps, torch.tensor(JOINTS_OF)] + motions.root[taps]
    arm = usual_place(motions.offsets[list(clips)])
    spread = torch.full((len(clips),), SMOOTHING / motion.RATE)
    told = measure(turns, places, arm, spread, NoError)
    return features(*told, height), truth, (begin[0][:, 0], begin[3][:, 0]), counts, index


def full_rotations(six):
    """(..., 15, 6) answers to (..., 22, 3, 3) in the pelvis's frame; the rest hangs on straight."""
    matrix = six_to_matrix(six)
    parts = [torch.eye(3).expand(*six.shape[:-2], 3, 3)]
    for joint in range(1, JOINTS):
        if joint in REDUCED:
            parts.append(matrix[..., REDUCED.index(joint), :, :])
        else:
            parts.append(parts[PARENTS[joint]])
    return torch.stack(parts, -3)


def positions(turns, offsets):
    """Joints from the pelvis, (..., 22, 3), for rotations in its frame."""
    parts = [torch.zeros_like(turns[..., 0, :, 0])]
    for joint in range(1, JOINTS):
        parent = PARENTS[joint]
        arm = turns[..., parent, :, :] @ offsets[..., joint, :].unsqueeze(-1)
        parts.append(parts[parent] + arm.squeeze(-1))
    return torch.stack(parts, -2)


def clip_errors(out, truth, true_turns, offsets, height, n, span):
    """Errors over the first n frames of one clip."""
    turns = full_rotations(out["rotations"][:n].unflatten(-1, (-1, 6)))
    angle = geodesic(turns, true_turns[:n]).rad2deg()
    place, true_place = positions(turns, offsets), positions(true_turns[:n], offsets)
    way = (out["velocities"][:n] - truth[3][:n]).unflatten(-1, (-1, 3))[:, 0] * height * span
    second = max(1, round(1 / span))
    blocks = [way[a : a + second].sum(0).norm() for a in range(0, n - second + 1, second)]
    stands = torch.sigmoid(out["contact"][:n]) > 0.5
    return {
        "sip_deg": angle[:, SIP].mean().item(),
        "angle_deg": angle[:, REDUCED].mean().item(),
        "joint_cm": 100 * (place - true_place).norm(dim=-1).mean().item(),
        "leaf_cm": 100 * height.item() * (out["leaves"][:n] - truth[0][:n]).unflatten(
            -1, (-1, 3)).norm(dim=-1).mean().item(),
        "way_cm_s": 100 * (torch.stack(blocks).mean().item() if blocks else 0.0),
        "contact": (stands == (truth[4][:n] > 0.5)).float().mean().item(),
    }


@torch.no_grad()
def evaluate(model, motions, clips, stride=1, batch=48, initial=True):
    """Errors of each clip."""
    order = sorted(clips, key=lambda c: motions.frames(c)[1] - motions.frames(c)[0])
    rows = []
    for a in range(0, len(order), batch):
        part = [c for c in order[a : a + batch]
                if motions.frames(c)[1] - motions.frames(c)[0] > 3 * EDGE + 8 * stride]
        if not part:
            continue
        x, truth, begin, counts, index = whole_clips(motions, part, stride)
        truth = (*truth, motions.contact[index].float())
        state = model.begin(*begin) if initial else model.initial_state(len(part))
        answers = []
        for b in range(0, x.shape[1], CHUNK):
            out, state = model(x[:, b : b + CHUNK], state)
            answers.append(out)
        out = {n: torch.cat([o[n] for o in answers], 1) for n in answers[0]}
        quats = motions.turns[index].float()
        world = quat_to_matrix(quats / quats.norm(dim=-1, keepdim=True))
        local = world[:, :, :1].mT @ world
        for i, c in enumerate(part):
            rows.append(clip_errors(
                {n: v[i] for n, v in out.items()}, [t[i] for t in truth], local[i],
                motions.offsets[c], motions.height[c], int(counts[i]), stride / motion.RATE))
    return rows


def table(model, motions, per_set=None, stride=1):
    """Yields means by set."""
    for name, clips in command.clips_by_set(motions.sources, per_set):
        rows = evaluate(model, motions, clips, stride)
        yield name, {**command.mean_of(rows), "clips": len(rows)}


def main():
    parser = command.parser(__doc__)
    parser.add_argument("--stride", type=int, default=1)
    args = parser.parse_args()
    torch.set_num_threads(1)
    motions = motion.cached(args.mocap, args.cache, args.sets.split(","), args.splits.split(","))
    rows = table(load_model(args.checkpoint), motions, args.per_set, args.stride)
    command.write(rows, args.out)


if __name__ == "__main__":
    main()
