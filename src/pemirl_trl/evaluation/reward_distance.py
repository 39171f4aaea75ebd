r"""Distances between rewards that differ by more than a scale, a constant and potential shaping.

Adding gamma Phi(s') - Phi(s) to a reward leaves the optimal policies as they are under all dynamics
(Ng, Harada and Russell, ICML 1999), so a distance should not see it. Both distances here first map
a reward to a representative of all its shaped copies (the canonical form), then measure the angle
between two of those over a distribution of transitions:

- :func:`epic_distance` asks rewards of *any* (s, a, s'), reachable or not. It has no parameter, and
  is exact for every potential;
- :func:`feasible_distance` asks them of the given transitions alone. A learned f(s, a, s') that has
  only ever seen the environment's own transitions means something there, and nowhere else.

Rewards are functions of transitions of batch size ``[C, B]``: C tasks, B transitions of each.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Generator, Tensor

__all__ = [
    "RewardFunction",
    "canonicalise_epic",
    "canonicalise_feasible",
    "epic_distance",
    "evaluate_reward",
    "feasible_distance",
    "independent_samples",
    "pearson_distance",
    "radial_basis",
    "shaping_subspace",
    "with_transitions",
]

RewardFunction = Callable[[TensorDictBase], Tensor]
"""Transitions ``[C, B]`` with ``observation``, ``action``, ``("next", "observation")``, and what
else the caller put there (a context, the task), to rewards ``[C, B]`` or ``[C, B, 1]``."""

_KEYS = ("observation", "action", ("next", "observation"))
_EVALUATIONS = 2**15  # transitions that a reward is asked for at once: these stay in the cache
_ROUNDING = 1e-9  # a canonical form this small beside its reward is rounding
_ROWS_PER_FEATURE = 4  # fewer transitions are fitted by shaping, whatever their rewards


def with_transitions(
    like: TensorDictBase, observation: Tensor, action: Tensor, next_observation: Tensor
) -> TensorDict:
    """Other transitions ``[C, B, ...]`` of the tasks of ``like``.

    Args:
        like: batch size ``[C, ...]``; its keys other than a transition's (the context, the task)
            must be the same in all transitions of a task, and are taken from the first.
        observation: ``[C, B, S]``.
        action: ``[C, B, A]``.
        next_observation: ``[C, B, S]``.

    Returns:
        batch size ``[C, B]``; of ``next`` it has the observation alone.
    """
    shape = observation.shape[:2]
    constant = like.exclude("observation", "action", "next")[:, :1].expand(*shape)
    batch = TensorDict(constant.to_dict(), batch_size=shape, device=like.device)
    for key, value in zip(_KEYS, (observation, action, next_observation), strict=True):
        batch.set(key, value)
    return batch


@torch.no_grad()
def evaluate_reward(reward: RewardFunction, transitions: TensorDictBase) -> Tensor:
    """Rewards ``[C, B]`` in float64.

    Raises:
        ValueError: the batch is not ``[C, B]``, or the reward is not one finite number each.
    """
    shape = transitions.batch_size
    if len(shape) != 2:
        raise ValueError(f"got transitions of batch size {list(shape)}; expected [C, B]")
    values = reward(transitions)
    if values.shape not in (shape, (*shape, 1)) or not bool(values.isfinite().all()):
        raise ValueError(
            f"the reward gave shape {list(values.shape)}, all finite: "
            f"{bool(values.isfinite().all())}; expected finite numbers {list(shape)}"
        )
    return values.reshape(shape).double()


def pearson_distance(x: Tensor, y: Tensor) -> Tensor:
    r"""sqrt((1 - rho) / 2), rho the Pearson correlation along the last dimension.

    Computed as half the distance between the two centred vectors of length 1, which is the same and
    loses no digits where rho is near 1. (Gleave et al., ICLR 2021, Definition 4.5.)

    Args:
        x: ``[..., n]``.
        y: ``[..., n]``.

    Returns:
        ``[...]`` in [0, 1]: 0 for positively scaled and shifted copies, 1 for negated ones, about
        sqrt(1/2) for unrelated ones; NaN where one is constant.
    """
    a, b = (values - values.mean(-1, keepdim=True) for values in (x, y))
    a, b = (values / values.norm(dim=-1, keepdim=True) for values in (a, b))
    return (a - b).norm(dim=-1) / 2


def independent_samples(
    coverage: TensorDictBase, n: int, generator: Generator | None = None
) -> TensorDict:
    """Draw S, A and S' independently from the marginals of a coverage distribution.

    Args:
        coverage: transitions ``[C, B]``; S and S' are both drawn from ``observation``, within a
            task.
        n: how many triples.
        generator: of the draws.

    Returns:
        ``[C, n]`` triples, few of which any dynamics would allow.
    """
    C, B = coverage.batch_size
    tasks = torch.arange(C)[:, None]
    s, a, following = torch.randint(B, (3, C, n), generator=generator)
    observation, action = coverage["observation"], coverage["action"]
    return with_transitions(
        coverage, observation[tasks, s], action[tasks, a], observation[tasks, following]
    )


def canonicalise_epic(
    reward: RewardFunction, transitions: TensorDictBase, samples: TensorDictBase, gamma: float
) -> Tensor:
    r"""C(R)(s, a, s') = R(s, a, s') + E[gamma R(s', A, S') - R(s, A, S') - gamma R(S, A, S')].

    With the same samples of (S, A, S') for every transition, shaping cancels up to a constant
    whatever their number, since E[Phi(S')] is one number. (Gleave et al., ICLR 2021, "Quantifying
    Differences in Reward Functions", Definition 4.1.)

    Args:
        reward: R.
        transitions: ``[C, B]``, where C(R) is asked for; see :func:`with_transitions` for its keys.
        samples: ``[C, n]``, independent triples, see :func:`independent_samples`.
        gamma: discount.

    Returns:
        ``[C, B]`` float64.
    """
    C, n = samples.batch_size
    direct = evaluate_reward(reward, transitions)
    elsewhere = evaluate_reward(reward, samples)
    origin = direct[:, :1]  # any constant cancels; without it, it also does in rounding
    action, following = (samples[key].unsqueeze(1) for key in _KEYS[1:])  # [C, 1, n, ...]

    def expectation(states: Tensor) -> Tensor:
        """E R(s, A, S') ``[C, b]`` of states ``[C, b, S]``."""
        shape = (C, states.shape[1], n)
        parts = [states.unsqueeze(2), action, following]
        product = [p.expand(*shape, p.shape[-1]).reshape(C, -1, p.shape[-1]) for p in parts]
        values = evaluate_reward(reward, with_transitions(transitions, *product))
        return (values - origin).view(shape).mean(-1)

    size = max(1, _EVALUATIONS // (C * n))
    here, there = (
        torch.cat([expectation(states) for states in transitions[key].split(size, dim=1)], dim=1)
        for key in (_KEYS[0], _KEYS[2])
    )
    anywhere = (elsewhere - origin).mean(-1, keepdim=True)
    direct = direct - origin
    return _without_rounding(direct + gamma * there - here - gamma * anywhere, direct)


def epic_distance(
    first: RewardFunction,
    second: RewardFunction,
    transitions: TensorDictBase,
    samples: TensorDictBase,
    gamma: float,
) -> Tensor:
    """EPIC: the Pearson distance of the canonical forms over the transitions, ``[C]`` in [0, 1].

    Its arguments are those of :func:`canonicalise_epic`; NaN where a reward is constant.
    (Gleave et al., ICLR 2021, Definition 4.6.)
    """
    forms = (canonicalise_epic(r, transitions, samples, gamma) for r in (first, second))
    return pearson_distance(*forms)


def radial_basis(
    observation: Tensor, count: int = 64, generator: Generator | None = None
) -> Callable[[Tensor], Tensor]:
    """A basis for smooth potentials: Gaussian bumps, and the standardised observation itself.

    The centres are drawn from the observations; the bumps are one standard deviation wide.

    Args:
        observation: ``[..., S]``, the states that matter.
        count: number of bumps.
        generator: of the centres.

    Returns:
        a function of observations ``[..., S]`` to features ``[..., count + S]``, float64.
    """
    states = observation.double().flatten(0, -2)
    mean, std = states.mean(0), states.std(0).clamp_min(torch.finfo(torch.float32).tiny)
    states = (states - mean) / std
    centres = states[torch.randint(len(states), (count,), generator=generator)]

    def features(observation: Tensor) -> Tensor:
        z = (observation.double() - mean) / std
        squared = (z.unsqueeze(-2) - centres).square().sum(-1)
        return torch.cat([(-squared / 2).exp(), z], dim=-1)

    return features


def shaping_subspace(features: Tensor, next_features: Tensor, gamma: float) -> Tensor:
    r"""Orthonormal basis of the rewards that are a constant plus shaping, on given transitions.

    These are c + gamma g(s') - g(s), where g is linear in features phi.

    Args:
        features: phi(s), ``[C, B, K]``.
        next_features: phi(s'), ``[C, B, K]``.
        gamma: discount.

    Returns:
        ``[C, B, K + 1]`` float64; columns that depend on others are zero.

    Raises:
        ValueError: fewer than 4 (K + 1) transitions, which shaping would fit whatever R is.
    """
    B, K = features.shape[-2:]
    if B < _ROWS_PER_FEATURE * (K + 1):
        raise ValueError(
            f"got {B} transitions per task for {K} features; expected at least "
            f"{_ROWS_PER_FEATURE * (K + 1)}"
        )
    shaping = (gamma * next_features - features).double()
    design = torch.cat([torch.ones_like(shaping[..., :1]), shaping], dim=-1)
    # By singular values: with a one-hot phi and gamma = 1, say, the columns depend on each other.
    u, s, _ = torch.linalg.svd(design, full_matrices=False)
    independent = s > s[:, :1] * B * torch.finfo(s.dtype).eps
    return u * independent.unsqueeze(-2)


def canonicalise_feasible(reward: Tensor, shaping: Tensor) -> Tensor:
    r"""What shaping cannot explain: the residual R + gamma g(s') - g(s) - c of the best g and c.

    This is the minimal canonical form under the L2 norm (Skalse et al., ICLR 2024, "STARC: A
    General Framework For Quantifying Differences Between Reward Functions"): the shortest of all
    shaped copies of R, with the norm of the coverage distribution. As the residual of a linear
    regression it is linear in R: potentials in the span of the features, and constants, cancel
    exactly, without a value function, whose estimate would have to be told what follows the last
    step of an episode. Dynamics enter through the transitions alone, and none is made up.

    Transitions of one deterministic policy under deterministic dynamics leave nothing: there every
    reward is a shaping (by minus its value). Coverage needs several actions in a state.

    Args:
        reward: R of transitions, ``[C, B]``.
        shaping: ``[C, B, K + 1]``, :func:`shaping_subspace` of the same transitions.

    Returns:
        ``[C, B]`` float64 of mean zero; zero where R is a constant plus shaping, up to rounding.
    """
    values = (reward - reward[:, :1]).double().unsqueeze(-1)  # any constant cancels
    residual = values - shaping @ (shaping.mT @ values)
    return _without_rounding(residual.squeeze(-1), values.squeeze(-1))


def feasible_distance(first: Tensor, second: Tensor, shaping: Tensor) -> Tensor:
    """Pearson distance of two rewards ``[C, B]`` after :func:`canonicalise_feasible`.

    Args:
        first: rewards of transitions, ``[C, B]``.
        second: those of the other reward function, on the same transitions.
        shaping: ``[C, B, K + 1]``, :func:`shaping_subspace` of the same transitions.

    Returns:
        ``[C]`` in [0, 1]; NaN where a reward is a constant plus shaping, and so prefers nothing.
    """
    return pearson_distance(*(canonicalise_feasible(r, shaping) for r in (first, second)))


def _without_rounding(form: Tensor, values: Tensor) -> Tensor:
    """``form`` ``[C, B]``, but zero where it is the rounding error of cancelled ``values``."""
    small = form.norm(dim=-1, keepdim=True) <= _ROUNDING * values.norm(dim=-1, keepdim=True)
    return form.masked_fill(small, 0.0)
