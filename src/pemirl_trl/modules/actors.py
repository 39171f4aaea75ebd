"""The context policy pi_omega(a | s, m) and a value function of (s, m, t)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase, dispatch
from tensordict.utils import NestedKey
from torch import Tensor, nn

from pemirl_trl.modules.context_encoder import diagonal_normal
from pemirl_trl.modules.network import RowwiseMLP
from pemirl_trl.modules.policy import ContextActor
from pemirl_trl.modules.reading import beside, read
from pemirl_trl.modules.standardize import Standardize


class _GaussianNet(nn.Module):
    def __init__(
        self,
        net: RowwiseMLP,
        standardize: Standardize,
        log_scale: nn.Parameter,
        standardize_context: Standardize | None,
    ) -> None:
        super().__init__()
        self.standardize, self.net, self.log_scale = standardize, net, log_scale
        self.standardize_context = standardize_context

    def forward(self, observation: Tensor, context: Tensor) -> tuple[Tensor, Tensor]:
        loc = self.net(*self._inputs(observation, context))
        return loc, self.log_scale.exp().expand_as(loc)

    def linearised(self, observation: Tensor, context: Tensor) -> tuple[list[Tensor], list[Tensor]]:
        """:meth:`RowwiseMLP.linearised` of the mean."""
        return self.net.linearised(*self._inputs(observation, context))

    def _inputs(self, observation: Tensor, context: Tensor) -> tuple[Tensor, Tensor]:
        if self.standardize_context is not None:
            context = self.standardize_context(context)
        return self.standardize(observation), beside(context, observation)


class ContextPolicy(ContextActor):
    """The policy pi(a | s, m): a diagonal Gaussian, its mean an MLP, its deviation a constant.

    Reads ``observation`` ``[..., S]`` and ``context`` ``[..., D]``; writes ``loc``, ``scale``,
    ``action`` ``[..., A]`` and ``action_log_prob`` ``[...]``, the density of the action as drawn:
    a simulator that clamps its controls changes what the action does, not how likely it was. (Yu,
    Yu, Finn and Ermon, 2019, "Meta-Inverse Reinforcement Learning with Probabilistic Context
    Variables", arXiv:1909.09314, Appendix E.1.)

    Attributes:
        observation_key, context_key: what it reads.
        loc_key, scale_key, action_key, log_prob_key: what it writes.

    Args:
        observation_dim, action_dim, context_dim: S, A and D.
        hidden, activation: of the mean (the paper's: 2 x 64).
        standardize: map of observations; by default none.
        initial_scale: deviation before training, in the units of an action.
        learn_scale: whether the deviation is learned, or held (and moved by schedules alone).
            Where a simulator clamps actions, entropy costs nothing beyond the clamp, and an
            entropy-seeking objective would buy it without end: hold the deviation there.
        standardize_context: map of contexts; by default none. A goal in metres needs one beside
            observations in deviations.
        context_key: where m stands. An expert that knows its task reads the task parameters
            instead of a context: ``context_key=("task", "goal")``.
        log_prob_key: where log pi is written. A :class:`pemirl_trl.TRPOLoss` of this policy reads
            it there; for a discriminator, ``AIRLDiscriminator(reward, policy.log_prob_key)``.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> policy = ContextPolicy(observation_dim=6, action_dim=2, context_dim=3)
        >>> states, m = torch.randn(4, 6), torch.randn(4, 3)
        >>> batch = TensorDict({"observation": states, "context": m}, [4])
        >>> policy(batch)["action"].shape
        torch.Size([4, 2])
        >>> policy.get_dist(batch).log_prob(batch["action"]).shape
        torch.Size([4])
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
        initial_scale: float = 1.0,
        learn_scale: bool = True,
        standardize_context: Standardize | None = None,
        context_key: NestedKey = "context",
        log_prob_key: NestedKey = "action_log_prob",
    ) -> None:
        net = RowwiseMLP(observation_dim + context_dim, action_dim, hidden, activation)
        log_scale = torch.full((action_dim,), math.log(initial_scale))
        gaussian = _GaussianNet(
            net,
            standardize or Standardize.identity(observation_dim),
            nn.Parameter(log_scale, requires_grad=learn_scale),
            standardize_context,
        )
        super().__init__(
            gaussian,
            ["loc", "scale"],
            diagonal_normal,
            action_dim=action_dim,
            context_key=context_key,
            log_prob_key=log_prob_key,
        )
        self.loc_key, self.scale_key = "loc", "scale"

    @property
    def gaussian(self) -> _GaussianNet:
        """The network of mean and deviation."""
        return self.network

    @property
    def log_peak(self) -> Tensor:
        """The logarithm of the density at the mean, the same for all inputs; a scalar."""
        return -(self.log_scale + 0.5 * math.log(2 * math.pi)).sum()


class _ValueNet(nn.Module):
    def __init__(self, net: nn.Module, standardize: Standardize, horizon: int) -> None:
        super().__init__()
        self.standardize, self.net, self.horizon = standardize, net, horizon

    def forward(self, observation: Tensor, context: Tensor) -> Tensor:
        if observation.ndim < 2 or observation.shape[-2] > self.horizon:
            raise ValueError(
                f"got observations {list(observation.shape)}; expected episodes "
                f"[N, T, {self.standardize.features}] of at most {self.horizon} steps, since the "
                "value depends on the time: do not flatten N and T"
            )
        t = torch.arange(observation.shape[-2], dtype=observation.dtype) / self.horizon
        time = t.to(observation.device).unsqueeze(-1).expand(*observation.shape[:-1], 1)
        return self.net(self.standardize(observation), beside(context, observation), time)


class ContextValue(TensorDictModuleBase):
    """The value V(s, m, t) of a finite-horizon task: an MLP that also sees the time t / T.

    Reads whole episodes from their first step, ``observation`` ``[..., T, S]`` and ``context``
    ``[..., T, D]``; writes ``state_value`` ``[..., T, 1]``, in the reward's units. For
    :class:`pemirl_trl.FiniteHorizonAdvantage` in the place of its linear baseline, fitted by
    :class:`pemirl_trl.ValueLoss`; the library's own methods use the linear one.

    Attributes:
        observation_key, context_key: what it reads.
        value_key: where it writes.

    Args:
        observation_dim, context_dim: S and D.
        horizon: T, in steps.
        hidden, activation: of the network.
        standardize: map of observations; by default none.
        context_key: where m stands.
        value_key: where V is written.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> value = ContextValue(observation_dim=6, context_dim=3, horizon=10)
        >>> episodes = TensorDict(
        ...     {"observation": torch.randn(4, 10, 6), "context": torch.randn(4, 10, 3)}, [4, 10]
        ... )
        >>> value(episodes)["state_value"].shape
        torch.Size([4, 10, 1])
    """

    def __init__(
        self,
        observation_dim: int,
        context_dim: int,
        horizon: int,
        *,
        hidden: Sequence[int] = (64, 64),
        activation: type[nn.Module] = nn.Tanh,
        standardize: Standardize | None = None,
        context_key: NestedKey = "context",
        value_key: NestedKey = "state_value",
    ) -> None:
        net = RowwiseMLP(observation_dim + context_dim + 1, 1, hidden, activation)
        super().__init__()
        self.module = _ValueNet(net, standardize or Standardize.identity(observation_dim), horizon)
        self.observation_key: NestedKey = "observation"
        self.context_key = context_key
        self.value_key = value_key
        self.in_keys: list[NestedKey] = [self.observation_key, self.context_key]
        self.out_keys: list[NestedKey] = [self.value_key]

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write V(s, m, t) into ``tensordict``.

        Raises:
            MissingKeyError: the batch lacks the observation or the context.
            ValueError: it holds more steps in a row than an episode has.
        """
        observation = read(tensordict, self.observation_key, "ContextValue", "observation")
        context = read(tensordict, self.context_key, "ContextValue", "context")
        return tensordict.set(self.value_key, self.module(observation, context))
