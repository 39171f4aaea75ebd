"""A Markov decision process so small that every trajectory can be listed."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from functools import cached_property

import torch
from tensordict import TensorDict
from torch import Tensor

from pemirl_trl.modules import ContextEncoder, ShapedReward


@dataclass(frozen=True)
class FiniteMDP:
    """Deterministic, with one start state: a trajectory is a sequence of actions.

    Attributes:
        next_state: ``[S, A]``, indices.
        observations: ``[S, O]``, what a network sees of each state.
        actions: ``[A, U]``, what a network sees of each action.
        contexts: ``[M, D]``, the values of m.
        prior: ``[M]``, p(m).
        horizon: T.
    """

    next_state: Tensor
    observations: Tensor
    actions: Tensor
    contexts: Tensor
    prior: Tensor
    horizon: int

    @classmethod
    def random(cls, states: int = 4, actions: int = 2, contexts: int = 2, horizon: int = 3):
        return cls(
            torch.randint(states, (states, actions)),
            torch.randn(states, 3),
            torch.randn(actions, 1),
            torch.randn(contexts, 2),
            torch.rand(contexts).softmax(0),
            horizon,
        )

    @cached_property
    def action_index(self) -> Tensor:
        """``[J, T]``: the actions of each of the J = A^T trajectories."""
        return torch.tensor(list(itertools.product(range(len(self.actions)), repeat=self.horizon)))

    @cached_property
    def state_index(self) -> Tensor:
        """``[J, T + 1]``: the states that each trajectory visits."""
        states = [torch.zeros(len(self.action_index), dtype=torch.int64)]
        for t in range(self.horizon):
            states.append(self.next_state[states[-1], self.action_index[:, t]])
        return torch.stack(states, 1)

    def rollouts(self, trajectories: Tensor, context: Tensor) -> TensorDict:
        """Chosen trajectories ``[N]`` under contexts ``[N, D]``, as a batch ``[N, T]``."""
        observation = self.observations[self.state_index[trajectories]]  # [N, T + 1, O]
        return TensorDict(
            {
                "observation": observation[:, :-1],
                "action": self.actions[self.action_index[trajectories]],
                "next": {"observation": observation[:, 1:]},
                "context": context.unsqueeze(1).expand(-1, self.horizon, -1),
            },
            [len(trajectories), self.horizon],
        )

    def log_q(self, encoder: ContextEncoder) -> Tensor:
        """log q_psi(m | tau) of every context and trajectory, ``[M, J]``."""
        everything = torch.arange(len(self.action_index))
        batch = self.rollouts(everything, self.contexts[:1].expand(len(everything), -1))
        batch.batch_size = batch.batch_size[:1]
        return encoder.get_dist(batch).log_prob(self.contexts.unsqueeze(1))

    def shaped(self, reward: ShapedReward) -> Tensor:
        """f_theta(s, a, s', m), ``[M, S, A]``."""
        shape = (len(self.contexts), *self.next_state.shape)
        batch = TensorDict(
            {
                "observation": self.observations[:, None].expand(*shape, -1),
                "next": {"observation": self.observations[self.next_state].expand(*shape, -1)},
                "context": self.contexts[:, None, None].expand(*shape, -1),
            },
            shape,
        )
        return reward(batch)["shaped_reward"].squeeze(-1)

    def returns(self, step: Tensor) -> Tensor:
        """Sums over each trajectory, ``[M, J]``, of a quantity ``[M, S, A]`` of its steps."""
        return step[:, self.state_index[:, :-1], self.action_index].sum(-1)

    def trajectory_probability(self, shaped: Tensor) -> Tensor:
        """p_theta(tau | m), proportional to exp(sum_t f), ``[M, J]``, from f ``[M, S, A]``."""
        return self.returns(shaped).softmax(-1)

    def soft_value_iteration(self, shaped: Tensor) -> tuple[Tensor, Tensor]:
        """Backward induction of the maximum-entropy problem over the horizon.

        Args:
            shaped: reward of a step, ``[M, S, A]``.

        Returns:
            log pi*(a | s, m, t), ``[T, M, S, A]``, and V(s, m, t), ``[T + 1, M, S]``.
        """
        values = [torch.zeros_like(shaped[..., 0])]
        log_policy = []
        for _ in range(self.horizon):
            q = shaped + values[0][:, self.next_state]
            values.insert(0, q.logsumexp(-1))
            log_policy.insert(0, q - values[0].unsqueeze(-1))
        return torch.stack(log_policy), torch.stack(values)

    def policy_log_probability(self, log_policy: Tensor) -> Tensor:
        """log of the probability ``[M, J]`` that ``[T, M, S, A]`` gives to each trajectory."""
        return sum(
            log_policy[t][:, self.state_index[:, t], self.action_index[:, t]]
            for t in range(self.horizon)
        )
