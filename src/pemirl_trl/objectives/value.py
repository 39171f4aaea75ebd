"""Value targets, advantages and value losses of the finite-horizon problem.

Convention at the last step: an episode ends by time alone, and the problem that is solved is the
paper's finite-horizon one, so nothing lies beyond step T and *nothing is bootstrapped* there. A
value that knows the time (a function of s, m and t) can represent this.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase, TensorDictParams, dispatch
from tensordict.utils import NestedKey
from torch import Tensor
from torch.nn.functional import mse_loss
from torchrl.objectives.value.functional import generalized_advantage_estimate

from pemirl_trl.functional import (
    discounted_return,
    ridge_prediction,
    standardize,
    time_polynomial_features,
)
from pemirl_trl.modules.reading import read
from pemirl_trl.objectives.common import KeyedLoss, require_time

AdvantageGroup = Literal["batch", "context"]


class ValueLoss(KeyedLoss):
    """The value's regression: ``loss_value`` = mean (V(s, m, t) - target)^2.

    The target is :class:`FiniteHorizonAdvantage`'s ``value_target`` ``[..., 1]``, as data; the loss
    is in squared units of the reward.

    Args:
        value: writes V ``[..., 1]`` where its ``value_key`` says, by default ``state_value``.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.

    Raises:
        MissingKeyError: on a call, the batch lacks a key.

    Example:
        >>> import torch
        >>> from pemirl_trl import ContextValue
        >>> value = ContextValue(observation_dim=6, context_dim=3, horizon=10)
        >>> advantage, loss = FiniteHorizonAdvantage(value=value), ValueLoss(value)
        >>> rollouts = TensorDict(
        ...     {
        ...         "observation": torch.randn(4, 10, 6),
        ...         "context": torch.randn(4, 10, 3),
        ...         "next": {"reward": torch.randn(4, 10, 1)},
        ...     },
        ...     [4, 10],
        ... )
        >>> loss(advantage(rollouts))["loss_value"].shape
        torch.Size([])
    """

    @dataclass
    class _AcceptedKeys:
        value: NestedKey = "state_value"
        value_target: NestedKey = "value_target"

    default_keys = _AcceptedKeys
    tensor_keys: _AcceptedKeys
    out_keys = ["loss_value"]  # noqa: RUF012 (TorchRL's convention)

    value_network: TensorDictModuleBase
    value_network_params: TensorDictParams
    target_value_network_params: TensorDictParams

    def __init__(self, value: TensorDictModuleBase, *, reduction: str = "mean") -> None:
        super().__init__()
        self.convert_to_functional(value, "value_network", create_target_params=False)
        self.reduction = reduction
        self.set_keys(value=_value_key(value))

    def _input_keys(self) -> list[NestedKey]:
        return [*self.value_network.in_keys, self.tensor_keys.value_target]

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDict:
        """Compute the loss.

        Args:
            tensordict: with what the value reads and ``value_target`` ``[..., 1]``.

        Raises:
            MissingKeyError: it lacks one of ``in_keys``.
        """
        target = self._read(tensordict, "value_target")
        inputs = _inputs(self.value_network, tensordict, "ValueLoss")
        with self.value_network_params.to_module(self.value_network, preserve_module_state=False):
            value = self.value_network(inputs)[self.tensor_keys.value]
        loss = mse_loss(value, target.detach(), reduction="none")
        return TensorDict({"loss_value": self._reduce_loss(loss, tensordict)})


def _value_key(value: TensorDictModuleBase) -> NestedKey:
    return getattr(value, "value_key", "state_value")


def _inputs(network: TensorDictModuleBase, batch: TensorDictBase, reader: str) -> TensorDictBase:
    for key in network.in_keys:
        read(batch, key, reader)
    return batch.select(*network.in_keys)


class FiniteHorizonAdvantage:
    """Generalised advantages of whole episodes ``[N, T]`` with a baseline.

    A_t = sum_k (gamma lmbda)^k (r_{t+k} + gamma V_{t+k+1} - V_{t+k}) with V = 0 after the last
    step: Equation 16 of Schulman, Moritz, Levine, Jordan and Abbeel (2016), "High-Dimensional
    Continuous Control Using Generalized Advantage Estimation", arXiv:1506.02438.

    Writes ``advantage`` and ``value_target``, both ``[N, T, 1]``; the target is in the reward's
    units, and so is the advantage before it is standardised. The baseline is a value network, or,
    with ``value=None``, the linear one of Duan, Chen, Houthooft, Schulman and Abbeel (2016),
    "Benchmarking Deep Reinforcement Learning for Continuous Control", arXiv:1604.06778, fitted in
    closed form to the returns of each context's own batch of rollouts on (s, s^2, t, t^2, t^3, 1).
    The return of their mean reward is taken out before the fit and added after it, so that a
    constant in the reward leaves advantages as they are. Where steps begin in an absorbing state
    (``absorbing`` ``[N, T]``, of :class:`pemirl_trl.AbsorbingState`), nothing is left to choose and
    to estimate: their value is their return-to-go, their advantage 0, and they count neither in the
    fit nor in the standardisation. Where a context has few more transitions
    than these 2 S + 4 features, the fit would interpolate: use a network.

    Args:
        gamma: discount per step.
        lmbda: of the generalised advantage; 1 gives return-to-go minus baseline.
        rollouts_per_context: how many consecutive rollouts share a linear fit.
        value: writes V ``[N, T, 1]`` where its ``value_key`` says, by default ``state_value``; run
            without gradients. None: the linear baseline.
        observation_map: applied to observations before the linear fit (their standardisation).
        standardize: over what advantages get zero mean and unit deviation: the ``"batch"``, the
            rollouts of each ``"context"``, so that no task's returns outweigh the others', or None.
        reward_key: which reward to use.
        observation_key: what the linear baseline is fitted on.
        absorbing_key: which steps begin in an absorbing state, where some do.

    Raises:
        ValueError: ``standardize`` is none of these; on a call, the batch has no time, or its rows
            are not K rollouts per context.
        MissingKeyError: on a call, the batch lacks the reward or what the baseline reads.

    Example:
        >>> import torch
        >>> rollouts = TensorDict(
        ...     {"observation": torch.randn(4, 10, 2), "next": {"reward": torch.randn(4, 10, 1)}},
        ...     [4, 10],
        ... )
        >>> rollouts = FiniteHorizonAdvantage(gamma=0.99, rollouts_per_context=2)(rollouts)
        >>> rollouts["advantage"].shape, bool(rollouts["advantage"].mean().abs() < 1e-5)
        (torch.Size([4, 10, 1]), True)
    """

    def __init__(
        self,
        *,
        gamma: float = 0.99,
        lmbda: float = 1.0,
        rollouts_per_context: int = 1,
        value: TensorDictModuleBase | None = None,
        observation_map: Callable[[Tensor], Tensor] = lambda x: x,
        standardize: AdvantageGroup | None = "batch",
        reward_key: NestedKey = ("next", "reward"),
        observation_key: NestedKey = "observation",
        absorbing_key: NestedKey = "absorbing",
    ) -> None:
        if standardize not in (None, *get_args(AdvantageGroup)):
            raise ValueError(
                f"standardize is {standardize!r}; expected None or one of "
                f"{get_args(AdvantageGroup)}"
            )
        self.gamma = gamma
        self.lmbda = lmbda
        self.rollouts_per_context = rollouts_per_context
        self.value = value
        self.observation_map = observation_map
        self.standardize = standardize
        self.reward_key, self.observation_key = reward_key, observation_key
        self.absorbing_key = absorbing_key

    @torch.no_grad()
    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``advantage`` and ``value_target`` into ``tensordict`` and return it.

        Args:
            tensordict: rollouts ``[N, T]``, context-major, with the reward ``[N, T, 1]``.

        Raises:
            MissingKeyError: it lacks the reward or what the baseline reads.
            ValueError: it has no dimension of time, or its rows are not K rollouts per context.
        """
        reward = read(tensordict, self.reward_key, "FiniteHorizonAdvantage")  # [N, T, 1]
        require_time(reward, "FiniteHorizonAdvantage", "reward")
        absorbing = tensordict.get(self.absorbing_key, None)
        acts = None if absorbing is None else ~absorbing.view_as(reward)
        value = self._baseline(tensordict, reward, acts)
        if acts is not None:
            settled = discounted_return(reward.squeeze(-1), self.gamma).unsqueeze(-1)
            value = torch.where(acts, value, settled)
        next_value = torch.cat([value[:, 1:], torch.zeros_like(value[:, :1])], 1)
        end = torch.zeros_like(reward, dtype=torch.bool)
        end[:, -1] = True
        advantage, target = generalized_advantage_estimate(
            self.gamma, self.lmbda, value, next_value, reward, done=end, terminated=end
        )
        if self.standardize == "batch":
            advantage = standardize(advantage, mask=acts)
        elif self.standardize == "context":
            mask = None if acts is None else self._by_context(acts)
            grouped = standardize(self._by_context(advantage), 1, mask=mask)
            advantage = grouped.view_as(advantage)
        return tensordict.set("advantage", advantage).set("value_target", target)

    def _baseline(self, tensordict: TensorDictBase, reward: Tensor, acts: Tensor | None) -> Tensor:
        if self.value is not None:
            inputs = _inputs(self.value, tensordict, "FiniteHorizonAdvantage")
            return self.value(inputs)[_value_key(self.value)]
        observation = read(tensordict, self.observation_key, "FiniteHorizonAdvantage")
        returns = self._by_context(discounted_return(reward.squeeze(-1), self.gamma).unsqueeze(-1))
        # What a constant reward of 1 returns is no cubic in t: a reward's level, which means
        # nothing, would leave an error in the baseline that buries its differences.
        annuity = discounted_return(torch.ones_like(reward.squeeze(-1)), self.gamma).unsqueeze(-1)
        level = self._by_context(reward).mean(1, keepdim=True) * self._by_context(annuity)
        features = time_polynomial_features(self.observation_map(observation)).to(reward.dtype)
        mask = None if acts is None else self._by_context(acts).squeeze(-1)
        rest = ridge_prediction(
            self._by_context(features), (returns - level).squeeze(-1), mask=mask
        )
        return (level.squeeze(-1) + rest).view_as(reward)

    def _by_context(self, values: Tensor) -> Tensor:
        """``[N, T, F]`` as ``[M, K T, F]``."""
        rollouts, horizon, size = values.shape
        if rollouts % self.rollouts_per_context:
            raise ValueError(
                f"got {rollouts} rollouts, which {self.rollouts_per_context} rollouts per context "
                "do not divide"
            )
        return values.reshape(-1, self.rollouts_per_context * horizon, size)
