"""Bookkeeping of lanes, which play one clip after another in chunks that join up."""

import torch


class LaneState:
    """What every lane remembers between chunks (`lane`: a tensor (lanes, ...) by name), and the
    lanes' own random numbers."""

    def __init__(self, seed):
        self.generator = torch.Generator().manual_seed(seed)
        self.lane = {}

    def state_dict(self):
        lane = {name: value.clone() for name, value in self.lane.items()}
        return {"lane": lane, "generator": self.generator.get_state()}

    def load_state_dict(self, state):
        self.lane = {name: value.clone() for name, value in state["lane"].items()}
        self.generator.set_state(state["generator"])

    def _normal(self, *shape):
        return torch.randn(*shape, generator=self.generator)

    def _uniform(self, *shape):
        return torch.rand(*shape, generator=self.generator)

    def _draw(self, weight, count):
        return torch.multinomial(weight, count, replacement=True, generator=self.generator)


def shares_of(told, usual):
    """The lanes' time of each set: `usual`, but for what `told` ("bandai=0.5,snu=0.1") says."""
    shares = dict(usual)
    for each in filter(None, (told or "").split(",")):
        name, _, share = each.partition("=")
        if name not in usual:
            raise ValueError(f"--shares: no set is called {name!r}: {', '.join(usual)}")
        shares[name] = float(share)
    return shares


def clip_weights(sources, length, usable, shares, span, visit):
    """How likely each clip is begun (clips,), so that the sets have `shares` of the lanes' time.

    `length` (clips,) frames; `span` frames of a chunk; after `visit` chunks a lane leaves a clip:
    a number, or (clips,). Long clips keep a lane longer, so they are begun less often.
    """
    weight = torch.zeros(len(sources), dtype=torch.double)
    for name, share in shares.items():
        mine = torch.tensor([s == name for s in sources]) & usable
        if mine.any():
            weight[mine] = share * length[mine] / length[mine].sum()
    chunks = length / span
    visit = torch.as_tensor(visit, dtype=torch.double)
    return weight / (torch.where(chunks < visit, chunks / 2, visit - visit**2 / (2 * chunks)) + 1)
