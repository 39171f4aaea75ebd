"""The learned reward r_theta(s, m) with its potential h_phi(s, m)."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey
from torch import Tensor, nn
from torchrl.modules import MLP

from pemirl_trl.functional import shaped_reward
from pemirl_trl.modules.standardize import Standardize


class ShapedReward(TensorDictModuleBase):
    r"""f(s, a, s', m) = r_theta(s, m) + gamma h_phi(s', m) - h_phi(s, m).

    Reads ``observation`` and ``("next", "observation")`` ``[..., S]`` and ``context``
    ``[..., D]``; writes ``learned_reward`` (r) and ``shaped_reward`` (f), both ``[..., 1]``.
    (Yu et al., 2019, Appendix E.1: r and h are MLPs of 2 x 32.)

    Args:
        observation_dim, context_dim: S and D.
        gamma: discount of the potential.
        hidden, activation: of both networks.
        standardize: map of observations; by default none.
    """

    in_keys: list[NestedKey]
    out_keys: list[NestedKey]

    def __init__(
        self,
        observation_dim: int,
        context_dim: int,
        *,
        gamma: float = 0.99,
        hidden: Sequence[int] = (32, 32),
        activation: type[nn.Module] = nn.ReLU,
        standardize: Standardize | None = None,
        context_key: NestedKey = "context",
    ) -> None:
        super().__init__()
        self.in_keys = ["observation", ("next", "observation"), context_key]
        self.out_keys = ["learned_reward", "shaped_reward"]
        self.gamma = gamma
        self.standardize = standardize or Standardize.identity(observation_dim)
        self.reward_net, self.potential_net = (
            MLP(
                in_features=observation_dim + context_dim,
                out_features=1,
                num_cells=list(hidden),
                activation_class=activation,
            )
            for _ in range(2)
        )

    def reward(self, observation: Tensor, context: Tensor) -> Tensor:
        """r(s, m) ``[..., 1]`` of observations ``[..., S]`` and contexts ``[..., D]``."""
        return self.reward_net(self.standardize(observation), context)

    def potential(self, observation: Tensor, context: Tensor) -> Tensor:
        """h(s, m) ``[..., 1]`` of observations ``[..., S]`` and contexts ``[..., D]``."""
        return self.potential_net(self.standardize(observation), context)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write r and f into ``tensordict``."""
        observation, next_observation, context = (tensordict.get(k) for k in self.in_keys)
        reward = self.reward(observation, context)
        shaped = shaped_reward(
            reward,
            self.potential(observation, context),
            self.potential(next_observation, context),
            self.gamma,
        )
        return tensordict.set(self.out_keys[0], reward).set(self.out_keys[1], shaped)


class AveragedReward(TensorDictModuleBase):
    r"""The mean of several reward functions, r(s, m) = 1/n sum_i r_i(s, m): no weights are averaged.

    Reads ``observation`` and ``context``; writes ``learned_reward`` ``[..., 1]``. Its members run
    as one batched network.

    Args:
        members: rewards of one architecture; their weights are copied.
    """

    in_keys: list[NestedKey]
    out_keys: list[NestedKey]

    def __init__(self, members: Sequence[ShapedReward]) -> None:
        super().__init__()
        if not members:
            raise ValueError("expected at least one reward to average, got none")
        self.in_keys = ["observation", members[0].in_keys[2]]
        self.out_keys = ["learned_reward"]
        self.standardize = members[0].standardize
        # An untracked skeleton: only the stacked weights are state.
        self.__dict__["_skeleton"] = copy.deepcopy(members[0].reward_net).to("meta")
        stacked, _ = torch.func.stack_module_state([m.reward_net for m in members])
        self._names = list(stacked)
        for name, values in stacked.items():
            self.register_buffer(name.replace(".", "__"), values.detach().clone())

    def reward(self, observation: Tensor, context: Tensor) -> Tensor:
        """r(s, m) ``[..., 1]`` of observations ``[..., S]`` and contexts ``[..., D]``."""
        weights = {name: self.get_buffer(name.replace(".", "__")) for name in self._names}
        inputs = torch.cat([self.standardize(observation), context], -1)

        def member(parameters: dict[str, Tensor]) -> Tensor:
            return torch.func.functional_call(self._skeleton, parameters, (inputs,))

        return torch.func.vmap(member)(weights).mean(0)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write r into ``tensordict``."""
        observation, context = (tensordict.get(k) for k in self.in_keys)
        return tensordict.set(self.out_keys[0], self.reward(observation, context))
