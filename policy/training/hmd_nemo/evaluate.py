"""Evaluates a checkpoint on splits of the shared sets.

    python -m hmd_nemo.evaluate --mocap DIR --checkpoint FILE --splits test,cross --sets hdm05
"""

import torch

from common import evaluate as command
from posed_mocap import store as stores
from posed_mocap.skeleton import HEAD, forward_kinematics
from posed_mocap.rotations import quat_to_matrix

from .checkpoint import load_model
from .lanes import CONTROLLERS, FIELD_OF_VIEW, Chunk
from .losses import pose_from
from .metrics import sequence_metrics
from .sample import build
from .visibility import random_loss

CHUNK = 240


def whole_clips(store, clips, scenario, seed=1):
    """A `Chunk` of whole clips, padded with their last frame to the longest; their lengths too.

    The first frame is doubled, so every velocity starts at zero, as it does after a reset.
    """
    spans = [store.frames(c) for c in clips]
    lengths = torch.tensor([b - a for a, b in spans])
    steps = torch.arange(-1, int(lengths.max()))
    index = torch.stack([a + steps.clamp(0, b - a - 1) for a, b in spans])
    quats = store.quats[index].float()
    quats = quats / quats.norm(dim=-1, keepdim=True)
    generator = torch.Generator().manual_seed(seed)
    count = len(clips)
    lost = random_loss(torch.zeros(count, 2, dtype=torch.bool), len(steps), generator)
    turn = torch.zeros(count, 3, 4)
    turn[..., 3] = 1
    return Chunk(
        quats, store.root[index], store.offsets[list(clips)], store.head_height[list(clips)],
        turn, lost, torch.full((count,), scenario), torch.ones(count, 1, dtype=torch.bool),
    ), lengths


def run(model, sample, device):
    """Local rotations over whole sequences, with the state carried from chunk to chunk."""
    frames, batch = sample.features.shape[1], sample.features.shape[0]
    state = model.initial_state(batch)
    reset = torch.ones(batch, 1, dtype=torch.bool, device=device)
    parts = []
    for a in range(0, frames, CHUNK):
        part = slice(a, a + CHUNK)
        out, state = model(
            sample.features[:, part].to(device), sample.visible[:, part].to(device), state, reset
        )
        reset = torch.zeros_like(reset)
        parts.append(out["local"].cpu())
    return torch.cat(parts, 1)


@torch.no_grad()
def evaluate(model, store, clips, scenario, batch=48):
    """Metrics of each clip, in the order of `clips`, and the share of frames with each hand."""
    model.eval()
    device = next(model.parameters()).device
    order = sorted(clips, key=lambda c: store.frames(c)[1] - store.frames(c)[0])
    rows, seen = {}, []
    for a in range(0, len(order), batch):
        part = order[a : a + batch]
        chunk, lengths = whole_clips(store, part, scenario)
        sample = build(chunk)
        local = run(model, sample, device)
        _, positions = pose_from(local, sample.offsets)
        _, true = forward_kinematics(quat_to_matrix(chunk.quats[:, 1:]), chunk.offsets[:, None])
        head = (true + chunk.root[:, 1:, None])[:, :, HEAD]
        for i, c in enumerate(part):
            n = int(lengths[i])
            if n < 8:
                continue
            rows[c] = sequence_metrics(
                local[i, :n], positions[i, :n], sample.local[i, :n], sample.positions[i, :n],
                sample.yaw[i, :n], head[i, :n],
            )
            rows[c]["frames"] = n
            seen.append(sample.visible[i, :n].float().mean(0))
    model.train()
    return [rows[c] for c in clips if c in rows], torch.stack(seen).mean(0).tolist()


def table(model, store, per_set=None):
    """Yields means by set and scenario."""
    for name, clips in command.clips_by_set(store.sources, per_set):
        for label, scenario in (("controllers", CONTROLLERS), ("field_of_view", FIELD_OF_VIEW)):
            rows, seen = evaluate(model, store, clips, scenario)
            yield f"{name}/{label}", {**command.mean_of(rows), "clips": len(rows), "visible": seen}


def main():
    parser = command.parser(__doc__)
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    torch.set_num_threads(args.threads)
    torch.set_float32_matmul_precision("medium")
    store = stores.cached(args.mocap, args.cache, args.sets.split(","), args.splits.split(","))
    command.write(table(load_model(args.checkpoint), store, args.per_set), args.out)


if __name__ == "__main__":
    main()
