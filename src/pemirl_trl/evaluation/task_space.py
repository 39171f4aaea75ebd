"""Which components of an observation tell tasks apart under dynamics that were not seen."""

from __future__ import annotations

import math

import torch
from torch import Tensor
from torch.nn.functional import one_hot, softplus
from torch.optim import Adam

_SPAN = 3.0  # deviations on each side that the bins cover; what lies beyond is in the last ones


def held_out_information(
    observations: Tensor,
    contexts: Tensor,
    bodies: Tensor,
    *,
    bins: int = 16,
    samples: int = 24,
    steps: int = 150,
    learning_rate: float = 0.05,
    generator: torch.Generator | None = None,
) -> Tensor:
    """What each component alone says about m under dynamics that its reward was not fitted to.

    For each body b and component i, a reward r_i(s_i, m) = w_i[bin(s_i)] . (1, m, m²) is fitted to
    the demonstrations of all *other* bodies: it tells them from the same ones under the context of
    another demonstration (the mismatched negatives of :class:`pemirl_trl.methods.BatchConfig`). On
    those of b its bound on the information is log 2 - cross-entropy, in nats:

        I_bi = log 2 - 1/2 E[softplus(-r_i(s_i, m)) + softplus(r_i(s_i, m'))].

    At most log 2; 0 says nothing; below 0 it is worse than nothing: what the component meant for
    the task under the other dynamics misleads here. A component whose smallest value over bodies is
    well above 0 is one that a reward may read where the dynamics change.

    Args:
        observations: ``[J, T, S]``.
        contexts: ``[J, D]``, one per demonstration; or ``[bodies, J, D]``, those to be used where a
            body is left out (:func:`agreed_contexts`).
        bodies: ``[J]``, int64: under which dynamics each was made, numbered from 0.
        bins: of a component, over six deviations.
        samples: steps drawn from each demonstration, the same for all components.
        steps, learning_rate: of Adam, on all draws at once.
        generator: of the draws.

    Returns:
        ``[bodies, S]``, nats per step.

    Raises:
        ValueError: shapes that do not fit, or fewer than two bodies.
    """
    count, horizon = observations.shape[:2]
    folds = int(bodies.max()) + 1 if len(bodies) else 0
    leading = [tuple(contexts.shape[:-1]), tuple(bodies.shape)]
    if leading not in ([(count,), (count,)], [(folds, count), (count,)]):
        raise ValueError(
            f"got {count} demonstrations, contexts {list(contexts.shape)} and bodies "
            f"{list(bodies.shape)}; expected [{count}, D] or [bodies, {count}, D], and [{count}]"
        )
    if folds < 2:
        raise ValueError("got demonstrations of one body; what holds under another needs two")
    times = torch.randint(horizon, (count, samples), generator=generator)
    indicator = _visits(observations.detach()[torch.arange(count).unsqueeze(-1), times], bins)
    own = _features(contexts).expand(folds, -1, -1)  # [F, J, K]
    other = own[:, within_bodies(bodies, generator)]
    # r of a bin is what counts, and how often it is visited: no need to keep the steps.
    held = one_hot(bodies, folds).T.float()  # [F, J]
    weights = torch.zeros(folds, observations.shape[-1], bins, own.shape[-1], requires_grad=True)
    optimizer = Adam([weights], lr=learning_rate)

    def losses() -> Tensor:  # [F, J, S]
        total = torch.zeros(())
        for features, sign in ((own, -1.0), (other, 1.0)):
            reward = torch.einsum("fsbk,fjk->fjsb", weights, features)
            total = total + 0.5 * (softplus(sign * reward) * indicator).sum(-1)
        return total

    kept = (1 - held) / (1 - held).sum(1, keepdim=True)
    for _ in range(steps):
        loss = torch.einsum("fjs,fj->", losses(), kept) + 1e-4 * weights.square().sum()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    with torch.no_grad():
        unseen = torch.einsum("fjs,fj->fs", losses(), held / held.sum(1, keepdim=True))
    return math.log(2) - unseen


def agreed_contexts(contexts: Tensor, tasks: Tensor, bodies: Tensor) -> Tensor:
    """What demonstrations of one task agree on, of their contexts; without the body left out.

    A context also holds what is one demonstration's own, or its body's. Kept are the directions
    along which contexts differ more between tasks than within one (Fisher's linear discriminants,
    of a ratio above 1; at least the best one), and of those the mean over the demonstrations of a
    task by the bodies that are not left out.

    Args:
        contexts: ``[J, D]``, means of q say.
        tasks: ``[J]``, equal numbers for the same task.
        bodies: ``[J]``, int64, numbered from 0.

    Returns:
        ``[bodies, J, K]``, K <= D: the contexts for where each body is left out.

    Raises:
        ValueError: a task that one body alone has demonstrated.
    """
    _, task = tasks.unique(return_inverse=True)
    member = one_hot(task).to(contexts)  # [J, C]
    centred = contexts - contexts.mean(0)
    means = (member.T @ centred) / member.sum(0).unsqueeze(-1)  # [C, D]
    within = centred - means[task]
    # Whitened by the scatter within tasks, what is left of the scatter between them is the ratio.
    scatter = within.T @ within / len(task)
    scatter = scatter + 1e-6 * scatter.diagonal().mean().clamp(min=1e-12) * torch.eye(len(scatter))
    values, axes = torch.linalg.eigh(scatter)
    whiten = axes / values.sqrt()
    between = means[task] @ whiten
    ratios, directions = torch.linalg.eigh(between.T @ between / len(task))
    kept = ratios > min(1.0, float(ratios[-1]) * 0.999)
    projected = centred @ whiten @ directions[:, kept]  # [J, K]
    seen = ~one_hot(bodies).bool().T  # [F, J]: who is not left out
    weights = torch.einsum("fj,jc->fcj", seen.to(contexts), member)
    total = weights.sum(-1, keepdim=True)
    if (total == 0).any():
        raise ValueError("a task was demonstrated by one body alone; expected two bodies of each")
    return (weights @ projected / total)[:, task]


def _visits(drawn: Tensor, bins: int) -> Tensor:
    """The share of steps ``[J, n, S]`` in each bin of each component, ``[J, S, bins]``."""
    flat = drawn.flatten(0, 1)
    scaled = (drawn - flat.mean(0)) / flat.std(0).clamp(min=1e-6)
    place = ((scaled + _SPAN) * (bins / (2 * _SPAN))).long().clamp(0, bins - 1)
    return one_hot(place, bins).float().mean(1)


def _features(contexts: Tensor) -> Tensor:
    """1, m and its squares, ``[..., J, 1 + 2 D]``, in deviations over the demonstrations."""
    scale = contexts.std(-2, keepdim=True).clamp(min=1e-6)
    scaled = ((contexts - contexts.mean(-2, keepdim=True)) / scale).detach()
    return torch.cat([torch.ones_like(scaled[..., :1]), scaled, scaled.square()], -1)


def within_bodies(bodies: Tensor, generator: torch.Generator | None) -> Tensor:
    """For each demonstration another one of the same body, ``[J]``: a random cycle of each."""
    partner = torch.empty_like(bodies)
    for body in bodies.unique():
        rows = (bodies == body).nonzero().flatten()
        order = rows[torch.randperm(len(rows), generator=generator)]
        partner[order] = order.roll(1)
    return partner
