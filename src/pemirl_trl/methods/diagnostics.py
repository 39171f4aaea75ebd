"""Measures of a training's health, for :class:`pemirl_trl.Health`; no update depends on them."""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from pemirl_trl.functional import (
    channel_information,
    dependence_on_context,
    kl_to_standard_normal,
    share_between_groups,
)
from pemirl_trl.modules import PEMIRLModel
from pemirl_trl.modules.family import FAR
from pemirl_trl.modules.network import device_of
from pemirl_trl.modules.reading import shown_of

ROWS = 2048
"""Steps, spread evenly over a batch, on which r is looked at: enough for shares of a percent."""


class Diagnostics:
    """What an iteration's rollouts say about q, r and the policy.

    Nothing is drawn at random and no gradient is computed, so that a training is the same, bit for
    bit, with and without.

    Args:
        model: q and r.
        demonstrations: batch size ``[J]``, leaves ``[J, T, ...]``; those that the rollouts'
            ``demonstration`` counts.
        rollouts_per_context: K; consecutive rollouts that share a context.
        reward_is_learned: whether r is still being trained. Where it is not, nothing is measured
            that judges r by the states of a policy: one that flies off makes any r look blind.
    """

    def __init__(
        self,
        model: PEMIRLModel,
        demonstrations: TensorDictBase,
        rollouts_per_context: int,
        *,
        reward_is_learned: bool = True,
    ) -> None:
        self.model, self._reward_is_learned = model, reward_is_learned
        self.demonstrations = demonstrations = demonstrations.to(device_of(model))
        self.rollouts_per_context = rollouts_per_context
        family, observed = model.family, demonstrations["observation"].flatten(0, -2)
        self._low = observed.amin(0) if family is None else family.low.to(observed.device)
        self._high = observed.amax(0) if family is None else family.high.to(observed.device)
        self._reads = [  # r is a function of a step's start; f alone reads the next observation
            key for key in model.reward.in_keys if not (isinstance(key, tuple) and "next" in key)
        ]

    @torch.no_grad()
    def __call__(self, rollouts: TensorDictBase, reward: Tensor) -> dict[str, float]:
        """Measure rollouts ``[M K, T]``, of which the policy was given ``reward`` ``[M K, T, 1]``.

        Returns:
            ``context/kl`` and ``context/information``: of q on the M demonstrations, in nats;
            ``context/in_return``, ``context/in_reward``: the shares of the spread of returns and of
            the variance of r that m explains;
            ``return/learned_deviation``: of the returns within a context;
            ``outside/share``, ``outside/rewarded``: the share of steps far outside of what was
            demonstrated, and of those among them where r is higher than on the demonstration.
            What one context, or no latent context, leaves undefined is not there.
        """
        k = self.rollouts_per_context
        first = rollouts[::k, 0]
        drawn = self.demonstrations[first["demonstration"]]
        returns = reward.sum((1, 2)).view(-1, k)  # [M, K]
        metrics: dict[str, Tensor] = {}
        if k > 1:
            metrics["return/learned_deviation"] = returns.var(1).mean().sqrt()
        if self.model.config.context_dim > 0 and len(first) > 1:
            metrics |= self._posterior(drawn)
            if k > 1:
                metrics["context/in_return"] = share_between_groups(returns)
        metrics |= self._reward(rollouts, drawn, first["context"])
        return {name: float(value) for name, value in metrics.items()}

    def _posterior(self, drawn: TensorDictBase) -> dict[str, Tensor]:
        q = self.model.encoder.get_dist(shown_of(drawn).select("observation", "action"))
        loc, scale = q.mean, q.stddev
        return {
            "context/kl": kl_to_standard_normal(loc, scale).mean(),
            "context/information": channel_information(loc, scale),
        }

    def _reward(
        self, rollouts: TensorDictBase, drawn: TensorDictBase, context: Tensor
    ) -> dict[str, Tensor]:
        count, horizon = len(context), rollouts.shape[1]
        total = rollouts.numel()
        rows = torch.linspace(0, total - 1, min(ROWS, total)).long()
        steps = rollouts.select("observation", "action").reshape(-1)[rows]
        task = rows // (horizon * self.rollouts_per_context)
        own = self._r(steps, context[task])
        demonstrated = self._on_demonstrations(drawn, context)  # [M]
        outside = self._far(steps["observation"])
        metrics = {
            "outside/share": outside.float().mean(),
            "outside/rewarded": (outside & (own > demonstrated[task])).float().mean(),
        }
        if self._reward_is_learned and self.model.config.context_dim > 0 and count > 1:
            shift = 1 + torch.arange(len(rows)) % (count - 1)  # each row meets another task's m
            other = self._r(steps, context[(task + shift) % count])
            metrics["context/in_reward"] = dependence_on_context(own, other)
        return metrics

    def _on_demonstrations(self, drawn: TensorDictBase, context: Tensor) -> Tensor:
        """The mean of r over each demonstration, with its own m: ``[M]``."""
        horizon = drawn["action"].shape[1]
        each = max(1, ROWS // len(context))
        times = torch.linspace(0, horizon - 1, min(each, horizon)).long()
        steps = TensorDict(
            {key: drawn[key][:, times] for key in ("observation", "action")},
            [len(context), len(times)],
        )
        m = context.unsqueeze(1).expand(-1, len(times), -1)
        return self._r(steps, m).mean(1)

    def _r(self, steps: TensorDictBase, context: Tensor) -> Tensor:
        batch = TensorDict(
            {"observation": steps["observation"], "action": steps["action"], "context": context},
            steps.batch_size,
        )
        return self.model.reward(batch.select(*self._reads))["learned_reward"].squeeze(-1)

    def _far(self, observation: Tensor) -> Tensor:
        """Whether a component is :data:`FAR` deviations outside of the demonstrated range."""
        beyond = torch.maximum(self._low - observation, observation - self._high)
        return (beyond / self.model.standardize.scale).amax(-1) > FAR
