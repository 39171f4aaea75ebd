"""What several components together tell of a task under dynamics that were not seen."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor
from torch.nn.functional import softplus
from torch.optim import AdamW

from pemirl_trl.evaluation.task_space import within_bodies

_CLIP = 3.0  # deviations, beyond which r is asked of the edge


def joint_information(
    observations: Tensor,
    contexts: Tensor,
    bodies: Tensor,
    sets: Sequence[Sequence[int]],
    *,
    hidden: int = 32,
    samples: int = 24,
    steps: int = 300,
    batch: int = 64,
    learning_rate: float = 5e-3,
    generator: torch.Generator | None = None,
) -> Tensor:
    """What sets of components say about m, all of a set together, under dynamics not fitted to.

    :func:`held_out_information` looks at one component at a time and finds no distance between two
    things. Here r(s, m) of a set is a network of two hidden layers, fitted to the demonstrations
    of all bodies but one, against the same ones under the context of another demonstration; its
    bound on the information is asked of the body that was left out. A network also finds each
    body's own habits better than bins do: below 0, which says that it misleads there, is what to
    expect of the whole state of a body that walks.

    Args:
        observations, contexts, bodies: as of :func:`held_out_information`.
        sets: of components, by number; one network for each, all at once.
        hidden: width of its layers.
        samples: steps drawn from each demonstration.
        steps, batch, learning_rate: of Adam; demonstrations in each step.
        generator: of all draws.

    Returns:
        ``[bodies, sets]``, nats per step, at most log 2.

    Raises:
        ValueError: a component that there is not, or an empty set.
    """
    count, horizon, size = observations.shape
    if not sets or any(not chosen or not set(chosen) <= set(range(size)) for chosen in sets):
        raise ValueError(f"got sets {[list(s) for s in sets]}; expected some of 0 to {size - 1}")
    times = torch.randint(horizon, (count, samples), generator=generator)
    states = _clipped(observations.detach()[torch.arange(count).unsqueeze(-1), times])
    folds = int(bodies.max()) + 1
    contexts = _scaled(contexts.detach().expand(folds, count, contexts.shape[-1]))
    partner = within_bodies(bodies, generator)
    keep = torch.zeros(len(sets), size + contexts.shape[-1], 1)
    keep[:, size:] = 1
    for i, chosen in enumerate(sets):
        keep[i, list(chosen)] = 1
    found = []
    for fold in range(folds):
        reward = _Rewards(keep, hidden, generator)

        def loss(rows: Tensor, m: Tensor, reward: _Rewards = reward) -> Tensor:  # [sets]
            own, other = reward(states[rows], m[rows]), reward(states[rows], m[partner[rows]])
            return 0.5 * (softplus(-own) + softplus(other)).mean((1, 2))

        m, seen = contexts[fold], (bodies != fold).nonzero().flatten()
        optimizer = AdamW(reward.weights, lr=learning_rate, weight_decay=0.1)
        for _ in range(steps):
            rows = seen[torch.randint(len(seen), (batch,), generator=generator)]
            optimizer.zero_grad()
            loss(rows, m).sum().backward()  # a network each: their gradients do not meet
            optimizer.step()
        with torch.no_grad():
            found.append(math.log(2) - loss((bodies == fold).nonzero().flatten(), m))
    return torch.stack(found)


class _Rewards:
    """A network r(s, m) for each set, which reads no other component."""

    def __init__(self, keep: Tensor, hidden: int, generator: torch.Generator | None) -> None:
        sets, size, _ = keep.shape

        def drawn(rows: int) -> Tensor:
            weight = torch.randn(sets, rows, hidden, generator=generator) / math.sqrt(rows)
            return weight.requires_grad_()

        self.keep = keep
        self.first, self.second = drawn(size), drawn(hidden)
        self.last = torch.zeros(sets, hidden, 1, requires_grad=True)
        self.shifts = [torch.zeros(sets, 1, hidden, requires_grad=True) for _ in range(2)]
        self.weights = [self.first, self.second, self.last, *self.shifts]

    def __call__(self, states: Tensor, m: Tensor) -> Tensor:
        """States ``[J, n, S]`` and contexts ``[J, D]`` as rewards ``[sets, J n, 1]``."""
        every = torch.cat([states, m.unsqueeze(1).expand(-1, states.shape[1], -1)], -1)
        inputs = every.flatten(0, 1).expand(len(self.keep), -1, -1)
        first = torch.baddbmm(self.shifts[0], inputs, self.first * self.keep).tanh()
        return torch.baddbmm(self.shifts[1], first, self.second).tanh() @ self.last


def _clipped(states: Tensor) -> Tensor:
    flat = states.flatten(0, 1)
    return ((states - flat.mean(0)) / flat.std(0).clamp(min=1e-6)).clamp(-_CLIP, _CLIP)


def _scaled(contexts: Tensor) -> Tensor:
    scale = contexts.std(-2, keepdim=True).clamp(min=1e-6)
    return (contexts - contexts.mean(-2, keepdim=True)) / scale
