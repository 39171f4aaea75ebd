"""The learned reward r_theta(s, m) with its potential h_phi(s, m)."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey
from torch import Tensor, nn

from pemirl_trl.functional import shaped_reward
from pemirl_trl.modules.network import RowwiseMLP
from pemirl_trl.modules.reading import beside, read
from pemirl_trl.modules.standardize import Standardize


class ShapedReward(TensorDictModuleBase):
    r"""The learned reward and its shaping, f(s, a, s', m) = r(s, m) + gamma h(s', m) - h(s, m).

    Reads ``observation`` and ``("next", "observation")`` ``[..., S]`` and ``context``
    ``[..., D]``; writes ``learned_reward`` (r) and ``shaped_reward`` (f), both ``[..., 1]``. Where
    the next observation is missing, only r is written. r and h are MLPs of 2 x 32, as in Appendix
    E.1 of Yu, Yu, Finn and Ermon (2019), "Meta-Inverse Reinforcement Learning with Probabilistic
    Context Variables", arXiv:1909.09314.

    Attributes:
        observation_key, next_observation_key, context_key: what it reads.
        reward_key, shaped_reward_key: where r and f are written.

    Args:
        observation_dim, context_dim: S and D.
        gamma: discount of the potential.
        hidden, activation: of both networks.
        standardize: map of observations; by default none.
        reward_features: which components of an observation r reads; None: all. The potential reads
            all. An extension of the paper: where new dynamics force other postures upon the body, a
            reward of every joint asks for the old ones.
        context_key: where m stands.

    Raises:
        ValueError: a component that observations do not have, or one twice.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> reward = ShapedReward(observation_dim=6, context_dim=3)
        >>> states, m = torch.randn(5, 6), torch.randn(1, 3)  # one context for all states
        >>> reward.reward(states, m).shape
        torch.Size([5, 1])
        >>> batch = TensorDict({"observation": states, "context": m.expand(5, 3)}, [5])
        >>> batch["next", "observation"] = torch.randn(5, 6)
        >>> reward(batch)[reward.shaped_reward_key].shape
        torch.Size([5, 1])
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
        self.observation_key: NestedKey = "observation"
        self.next_observation_key: NestedKey = ("next", "observation")
        self.context_key = context_key
        self.reward_key: NestedKey = "learned_reward"
        self.shaped_reward_key: NestedKey = "shaped_reward"
        self.in_keys = [self.observation_key, self.next_observation_key, self.context_key]
        self.out_keys = [self.reward_key, self.shaped_reward_key]
        self.gamma = gamma
        self.standardize = standardize or Standardize.identity(observation_dim)
        read = observation_dim if self.reward_features is None else len(self.reward_features)
        self.reward_net, self.potential_net = (
            RowwiseMLP(features + context_dim, 1, hidden, activation)
            for features in (read, observation_dim)
        )

    def reward(self, observation: Tensor, context: Tensor) -> Tensor:
        """Return r(s, m) ``[..., 1]``, without a unit.

        Args:
            observation: ``[..., S]``.
            context: ``[..., D]``; ``[D]``, or a size of 1, serves all observations.

        Raises:
            ValueError: the two shapes do not fit.
        """
        state = self.standardize(observation)
        if self.reward_features is not None:
            state = state[..., self.reward_features]
        return self.reward_net(state, beside(context, observation))

    def potential(self, observation: Tensor, context: Tensor) -> Tensor:
        """Return h(s, m) ``[..., 1]``; shapes and errors are those of :meth:`reward`."""
        return self.potential_net(self.standardize(observation), beside(context, observation))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write r and, where the next observation is given, f into ``tensordict``.

        Raises:
            MissingKeyError: the batch lacks the observation or the context.
        """
        observation = read(tensordict, self.observation_key, "ShapedReward", "observation")
        context = read(tensordict, self.context_key, "ShapedReward", "context")
        next_observation = tensordict.get(self.next_observation_key, None)
        reward = self.reward(observation, context)
        tensordict.set(self.reward_key, reward)
        if next_observation is None:  # r is a function of the state: maps of it have no next one
            return tensordict
        potentials = self._potentials(observation, next_observation, context)
        shaped = shaped_reward(reward, *potentials, self.gamma)
        return tensordict.set(self.shaped_reward_key, shaped)

    def _potentials(
        self, observation: Tensor, next_observation: Tensor, context: Tensor
    ) -> tuple[Tensor, Tensor]:
        """h(s, m) and h(s', m); along rollouts, where s' is the following s, h of each once."""
        if not _along_rollouts(observation, next_observation, context):
            potential = self.potential(observation, context)
            return potential, self.potential(next_observation, context)
        states = torch.cat([observation, next_observation[:, -1:]], 1)  # [N, T + 1, S]
        potential = self.potential(states, context[:, :1])
        return potential[:, :-1], potential[:, 1:]


def _along_rollouts(observation: Tensor, next_observation: Tensor, context: Tensor) -> bool:
    """Whether these are rollouts ``[N, T, ...]``, each under one context, and nothing but data."""
    return (
        observation.ndim == 3
        and observation.shape == next_observation.shape
        and not (observation.requires_grad or next_observation.requires_grad)
        and context.ndim == 3
        and torch.equal(observation[:, 1:], next_observation[:, :-1])
        and torch.equal(context, context[:, :1].expand_as(context))
    )


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
