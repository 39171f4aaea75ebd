"""The learned reward r_theta(s, m) with its potential h_phi(s, m)."""

from __future__ import annotations

from collections.abc import Sequence

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
        reward_features: which components of an observation r reads; None: all. The potential reads
            all. An extension of the paper: where new dynamics force other postures upon the body, a
            reward of every joint asks for the old ones.

    Raises:
        ValueError: a component that observations do not have, or one twice.
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
        reward_features: Sequence[int] | None = None,
        context_key: NestedKey = "context",
    ) -> None:
        super().__init__()
        self.reward_features = _checked(reward_features, observation_dim)
        self.in_keys = ["observation", ("next", "observation"), context_key]
        self.out_keys = ["learned_reward", "shaped_reward"]
        self.gamma = gamma
        self.standardize = standardize or Standardize.identity(observation_dim)
        read = observation_dim if self.reward_features is None else len(self.reward_features)
        self.reward_net, self.potential_net = (
            MLP(
                in_features=features + context_dim,
                out_features=1,
                num_cells=list(hidden),
                activation_class=activation,
            )
            for features in (read, observation_dim)
        )

    def reward(self, observation: Tensor, context: Tensor) -> Tensor:
        """r(s, m) ``[..., 1]`` of observations ``[..., S]`` and contexts ``[..., D]``."""
        state = self.standardize(observation)
        if self.reward_features is not None:
            state = state[..., self.reward_features]
        return self.reward_net(state, context)

    def potential(self, observation: Tensor, context: Tensor) -> Tensor:
        """h(s, m) ``[..., 1]`` of observations ``[..., S]`` and contexts ``[..., D]``."""
        return self.potential_net(self.standardize(observation), context)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write r and, where the next observation is given, f into ``tensordict``."""
        key, next_key, context_key = self.in_keys
        observation, context = tensordict[key], tensordict[context_key]
        next_observation = tensordict.get(next_key, None)
        reward = self.reward(observation, context)
        tensordict.set(self.out_keys[0], reward)
        if next_observation is None:  # r is a function of the state: maps of it have no next one
            return tensordict
        shaped = shaped_reward(
            reward,
            self.potential(observation, context),
            self.potential(next_observation, context),
            self.gamma,
        )
        return tensordict.set(self.out_keys[1], shaped)


def _checked(features: Sequence[int] | None, observation_dim: int) -> list[int] | None:
    if features is None:
        return None
    chosen = list(features)
    if not chosen or len(set(chosen)) < len(chosen) or not set(chosen) <= {*range(observation_dim)}:
        raise ValueError(
            f"reward_features is {chosen}; expected distinct numbers from 0 to "
            f"{observation_dim - 1}, the components of an observation"
        )
    return chosen
