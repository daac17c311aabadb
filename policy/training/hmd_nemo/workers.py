"""Processes that train one model together, each on its share of the batch.

On CPU cores shared with other work this beats threads: threads meet at the end of every small
operation and wait for the slowest, workers meet once a step.
"""

import os
import socket

import torch
import torch.distributed as dist
import torch.multiprocessing as multiprocessing


class Workers:
    """What one of `count` processes needs to know of the others."""

    def __init__(self, rank, count):
        self.rank, self.count = rank, count

    def share_gradients(self, parameters):
        """Averages the gradients over the workers, in place."""
        if self.count == 1:
            return
        grads = [p.grad for p in parameters if p.grad is not None]
        flat = torch.cat([g.flatten() for g in grads])
        dist.all_reduce(flat)
        flat /= self.count
        for grad, part in zip(grads, flat.split([g.numel() for g in grads])):
            grad.copy_(part.view_as(grad))

    def any_of(self, *flags):
        """For each flag, whether it is set in any worker."""
        if self.count == 1:
            return flags
        votes = torch.tensor([float(f) for f in flags])
        dist.all_reduce(votes)
        return [v > 0 for v in votes.tolist()]


def _enter(rank, job, args, port):
    os.environ.update(MASTER_ADDR="127.0.0.1", MASTER_PORT=str(port))
    dist.init_process_group("gloo", rank=rank, world_size=args.workers)
    job(Workers(rank, args.workers), args)
    dist.destroy_process_group()


def spawn(job, args):
    """Runs `job(workers, args)` in `args.workers` processes, or here when that is one."""
    if args.workers == 1:
        job(Workers(0, 1), args)
        return
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    multiprocessing.spawn(_enter, args=(job, args, port), nprocs=args.workers)
