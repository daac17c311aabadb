"""Muon for the hidden matrices, AdamW for everything else.

Muon (Jordan et al., 2024) makes every step of a weight matrix orthogonal, so that all its
directions learn at one speed; with the scale of Liu et al. (2025) it takes AdamW's learning rate.
Here it is worth its cost because steps are few: training runs on a CPU.
"""

import torch

SPLIT = ("from_input", "from_hidden", "qkv")
"""Layers whose outputs are three gates or projections side by side: each is its own matrix."""
PLAIN = ("embedding", "pose", "contact", "trajectory.", "auxiliary", "first_token", "norm", "bias",
         "forecast.1")
"""Inputs, outputs and vectors: AdamW."""


def orthogonal(matrices, steps=5):
    """Newton-Schulz iteration towards the nearest orthogonal matrix, (n, rows, columns).

    In bfloat16 on a GPU; a CPU without instructions for it is 18 times as fast in float32.
    """
    a, b, c = 3.4445, -4.7750, 2.0315
    tall = matrices.shape[-2] > matrices.shape[-1]
    x = matrices.mT if tall else matrices
    x = x / (x.norm(dim=(-2, -1), keepdim=True) + 1e-7)
    x = x.bfloat16() if x.is_cuda else x
    for _ in range(steps):
        gram = x @ x.mT
        x = torch.baddbmm(x, torch.baddbmm(gram, gram, gram, beta=b, alpha=c), x, beta=a)
    return (x.mT if tall else x).to(matrices.dtype)


class MuonAdamW(torch.optim.Optimizer):
    """One optimizer over a model's named parameters.

    `split` names the layers whose outputs are `split_blocks` matrices side by side, `plain` what
    is left to AdamW.
    """

    def __init__(self, named_parameters, lr, momentum=0.95, betas=(0.9, 0.99), weight_decay=0.01,
                 split=SPLIT, split_blocks=3, plain=PLAIN):
        groups = {}
        for name, parameter in named_parameters:
            adam = parameter.dim() < 2 or any(part in name for part in plain)
            inputs_last = "weight" in name and parameter.dim() == 2
            blocks = split_blocks if any(part in name for part in split) else 1
            key = "plain" if adam else (blocks, inputs_last)
            groups.setdefault(key, []).append(parameter)
        super().__init__(
            [{"params": params, "blocks": 0 if key == "plain" else key[0],
              "inputs_last": key != "plain" and key[1]} for key, params in groups.items()],
            dict(lr=lr, momentum=momentum, betas=betas, weight_decay=weight_decay),
        )

    @torch.no_grad()
    def step(self):
        for group in self.param_groups:
            for parameter in group["params"]:
                if parameter.grad is None:
                    continue
                parameter.mul_(1 - group["lr"] * group["weight_decay"])
                update = self._muon if group["blocks"] else self._adam
                update(parameter, group, self.state[parameter])

    def _adam(self, parameter, group, state):
        if not state:
            state["count"] = torch.zeros(())
            state["mean"] = torch.zeros_like(parameter)
            state["square"] = torch.zeros_like(parameter)
        state["count"] += 1
        first, second = group["betas"]
        state["mean"].lerp_(parameter.grad, 1 - first)
        state["square"].lerp_(parameter.grad.square(), 1 - second)
        count = state["count"].item()
        scale = (1 - second**count) ** 0.5 / (1 - first**count)
        denominator = state["square"].sqrt().add_(1e-8)
        parameter.addcdiv_(state["mean"], denominator, value=-group["lr"] * scale)

    def _muon(self, parameter, group, state):
        if not state:
            state["momentum"] = torch.zeros_like(parameter)
        state["momentum"].lerp_(parameter.grad, 1 - group["momentum"])
        change = parameter.grad.lerp(state["momentum"], group["momentum"])
        matrix = change.mT if group["inputs_last"] else change
        matrix = matrix if matrix.dim() == 3 else matrix.unsqueeze(0)
        parts = torch.cat(matrix.chunk(group["blocks"], -1))
        parts = orthogonal(parts) * (0.2 * max(parts.shape[-2:]) ** 0.5)
        whole = torch.cat(parts.chunk(group["blocks"]), -1)
        whole = whole if parameter.dim() == 3 else whole.squeeze(0)
        parameter.add_(whole.mT if group["inputs_last"] else whole, alpha=-group["lr"])
