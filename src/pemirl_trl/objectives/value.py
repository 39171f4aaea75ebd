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
from pemirl_trl.objectives.common import KeyedLoss

AdvantageGroup = Literal["batch", "context"]


class ValueLoss(KeyedLoss):
    """``loss_value`` = mean squared error of ``state_value`` against ``value_target``.

    Args:
        value: gives ``state_value`` ``[..., 1]``.
        reduction: ``"mean"``, ``"sum"`` or ``"none"``.
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

    def _input_keys(self) -> list[NestedKey]:
        return [*self.value_network.in_keys, self.tensor_keys.value_target]

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDict:
        """Compute the loss; ``value_target`` is ``[..., 1]``."""
        inputs = tensordict.select(*self.value_network.in_keys)
        with self.value_network_params.to_module(self.value_network, preserve_module_state=False):
            value = self.value_network(inputs)[self.tensor_keys.value]
        target = tensordict[self.tensor_keys.value_target]
        loss = mse_loss(value, target.detach(), reduction="none")
        return TensorDict({"loss_value": self._reduce_loss(loss, tensordict)})


class FiniteHorizonAdvantage:
    """Generalised advantages of whole episodes ``[N, T]`` with a baseline.

    Writes ``advantage`` and ``value_target``, both ``[N, T, 1]``. The baseline is a value
    network, or, with ``value=None``, the linear one of Duan et al. (2016), fitted in closed form to
    the returns of each context's own batch of rollouts on (s, s^2, t, t^2, t^3, 1). The return of
    their mean reward is taken out before the fit and added after it, so that a constant in the
    reward leaves advantages as they are. Where a context has few more transitions than these
    2 S + 4 features, the fit would interpolate: use a network.

    Args:
        gamma: discount.
        lmbda: of the generalised advantage; 1 gives return-to-go minus baseline.
        rollouts_per_context: how many consecutive rollouts share a linear fit.
        value: gives ``state_value`` ``[N, T, 1]``; run without gradients.
        observation_map: applied to observations before the linear fit (their standardisation).
        standardize: over what advantages get zero mean and unit deviation: the ``"batch"``, the
            rollouts of each ``"context"``, so that no task's returns outweigh the others', or None.
        reward_key: which reward to use.

    Raises:
        ValueError: ``standardize`` is none of these.
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
        self.reward_key = reward_key

    @torch.no_grad()
    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``advantage`` and ``value_target`` into ``tensordict`` and return it."""
        reward = tensordict[self.reward_key]  # [N, T, 1]
        value = self._baseline(tensordict, reward)
        next_value = torch.cat([value[:, 1:], torch.zeros_like(value[:, :1])], 1)
        end = torch.zeros_like(reward, dtype=torch.bool)
        end[:, -1] = True
        advantage, target = generalized_advantage_estimate(
            self.gamma, self.lmbda, value, next_value, reward, done=end, terminated=end
        )
        if self.standardize == "batch":
            advantage = standardize(advantage)
        elif self.standardize == "context":
            advantage = standardize(self._by_context(advantage), 1).view_as(advantage)
        return tensordict.set("advantage", advantage).set("value_target", target)

    def _baseline(self, tensordict: TensorDictBase, reward: Tensor) -> Tensor:
        if self.value is not None:
            return self.value(tensordict.select(*self.value.in_keys))["state_value"]
        returns = self._by_context(discounted_return(reward.squeeze(-1), self.gamma).unsqueeze(-1))
        # What a constant reward of 1 returns is no cubic in t: a reward's level, which means
        # nothing, would leave an error in the baseline that buries its differences.
        annuity = discounted_return(torch.ones_like(reward.squeeze(-1)), self.gamma).unsqueeze(-1)
        level = self._by_context(reward).mean(1, keepdim=True) * self._by_context(annuity)
        features = time_polynomial_features(self.observation_map(tensordict["observation"]))
        rest = ridge_prediction(self._by_context(features), (returns - level).squeeze(-1))
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
