"""The policy over a few choices, pi_omega(a | s, m) of one-hot actions."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from tensordict.utils import NestedKey
from torch import Tensor, nn
from torch.distributions import OneHotCategorical

from pemirl_trl.functional import mixed_with_uniform
from pemirl_trl.modules.network import RowwiseMLP
from pemirl_trl.modules.policy import ContextActor
from pemirl_trl.modules.reading import beside
from pemirl_trl.modules.standardize import Standardize


class _OneHot(OneHotCategorical):
    """Its likeliest choice is what deterministic exploration takes."""

    @property
    def deterministic_sample(self) -> Tensor:
        return self.mode


def one_hot_categorical(logits: Tensor) -> OneHotCategorical:
    """Return the distribution of one-hot vectors ``[..., n]`` with these logits ``[..., n]``."""
    return _OneHot(logits=logits, validate_args=False)


class _CategoricalNet(nn.Module):
    log_scale: Tensor

    def __init__(
        self,
        net: nn.Module,
        standardize: Standardize,
        log_scale: Tensor,
        standardize_context: Standardize | None,
    ) -> None:
        super().__init__()
        self.standardize, self.net = standardize, net
        self.register_buffer("log_scale", log_scale)
        self.standardize_context = standardize_context

    def forward(self, observation: Tensor, context: Tensor) -> tuple[Tensor]:
        if self.standardize_context is not None:
            context = self.standardize_context(context)
        logits = self.net(self.standardize(observation), beside(context, observation))
        return (mixed_with_uniform(logits, self.log_scale),)


class CategoricalPolicy(ContextActor):
    r"""The policy pi(a | s, m) of n discrete actions: (1 - eps) softmax(g(s, m))_a + eps / n.

    Reads ``observation`` ``[..., S]`` and ``context`` ``[..., D]``; writes ``logits`` ``[..., n]``,
    which are normalised log-probabilities, a one-hot ``action`` ``[..., n]`` of real numbers, as
    every network here reads it, and ``action_log_prob`` ``[...]``. Deterministic exploration takes
    the likeliest action. :class:`pemirl_trl.OneHotActions` hands such actions to an environment.

    A share eps of the actions is drawn uniformly. It stands where the Gaussian policy has its
    deviation: it sets how much is explored, schedules move it, and log pi >= log(eps / n) keeps a
    discriminator's f - log pi finite. A temperature would do none of this, since the logits could
    grow against it. It is never learned: no likelihood gains by it.

    Attributes:
        observation_key, context_key: what it reads.
        logits_key, action_key, log_prob_key: what it writes.

    Args:
        observation_dim, action_dim, context_dim: S, n and D.
        hidden, activation: of g.
        standardize: map of observations; by default none.
        initial_scale: eps before a schedule moves it, in (0, 1).
        standardize_context, context_key, log_prob_key: as in :class:`pemirl_trl.ContextPolicy`.

    Raises:
        ValueError: fewer than two actions, or eps outside of (0, 1).

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> policy = CategoricalPolicy(observation_dim=6, action_dim=4, context_dim=3)
        >>> states, m = torch.randn(5, 6), torch.randn(5, 3)
        >>> batch = policy(TensorDict({"observation": states, "context": m}, [5]))
        >>> batch["action"].sum(-1)
        tensor([1., 1., 1., 1., 1.])
        >>> policy.get_dist(batch).log_prob(batch["action"]).shape
        torch.Size([5])
    """

    def __init__(
        self,
        observation_dim: int,
        action_dim: int,
        context_dim: int,
        *,
        hidden: Sequence[int] = (64, 64),
        activation: type[nn.Module] = nn.ReLU,
        standardize: Standardize | None = None,
        initial_scale: float = 0.1,
        standardize_context: Standardize | None = None,
        context_key: NestedKey = "context",
        log_prob_key: NestedKey = "action_log_prob",
    ) -> None:
        if action_dim < 2:
            raise ValueError(f"got {action_dim} discrete actions; expected at least 2")
        check_share("initial_scale", initial_scale)
        net = RowwiseMLP(observation_dim + context_dim, action_dim, hidden, activation)
        log_scale = torch.full((1,), math.log(initial_scale))
        categorical = _CategoricalNet(
            net,
            standardize or Standardize.identity(observation_dim),
            log_scale,
            standardize_context,
        )
        super().__init__(
            categorical,
            ["logits"],
            one_hot_categorical,
            action_dim=action_dim,
            context_key=context_key,
            log_prob_key=log_prob_key,
        )
        self.logits_key = "logits"

    @property
    def log_peak(self) -> Tensor:
        """The logarithm of the largest probability that an action can have; a scalar."""
        share = self.log_scale.exp()
        return torch.log1p(share / self.action_dim - share).squeeze(0)


def check_share(name: str, value: float) -> None:
    """Raise ValueError unless ``value`` can be the share of uniform actions."""
    if not 0.0 < value < 1.0:
        raise ValueError(
            f"{name} is {value}; of discrete actions it is the share that is drawn uniformly, "
            "between 0 and 1"
        )
