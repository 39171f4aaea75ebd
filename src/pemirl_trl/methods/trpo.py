"""One trust-region update on a batch of rollouts: what every method does to its policy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import torch
from pydantic.dataclasses import dataclass
from tensordict import TensorDictBase
from torch import Tensor

from pemirl_trl.configuration import CHECKED, Count, NonNegative, Positive, Share
from pemirl_trl.methods.fisher import gaussian_fisher_product, has_closed_form
from pemirl_trl.modules.model import Policy
from pemirl_trl.modules.reading import acted_steps
from pemirl_trl.objectives import FiniteHorizonAdvantage, TRPOLoss
from pemirl_trl.optim import TrustRegionOptimizer


@dataclass(frozen=True, config=CHECKED)
class TRPOConfig:
    """Of one policy update.

    Attributes:
        gamma, lmbda: of the advantage.
        max_kl: trust region, in nats.
        cg_iterations, damping: of the conjugate gradient.
        fisher_rows: transitions for the Fisher-vector products, drawn from the batch.
        entropy_coeff: weight of the entropy beside standardised advantages.
        standardize: over what advantages are standardised, ``"batch"`` or ``"context"``; see
            :class:`pemirl_trl.FiniteHorizonAdvantage`.
    """

    gamma: Share = 0.99
    lmbda: Share = 1.0
    max_kl: Positive = 0.02
    cg_iterations: Count = 10
    damping: NonNegative = 1e-5
    fisher_rows: Count = 4000
    entropy_coeff: NonNegative = 0.0
    standardize: Literal["batch", "context"] = "batch"


class TRPO:
    """Advantages with a linear baseline per context, then one trust-region update.

    (Schulman et al., 2015, "Trust Region Policy Optimization", arXiv:1502.05477.)

    Args:
        policy: moved in place.
        config: of the step.
        rollouts_per_context: K; consecutive rollouts that share a context and a baseline.
    """

    def __init__(
        self,
        policy: Policy,
        config: TRPOConfig,
        rollouts_per_context: int,
    ) -> None:
        self.policy = policy
        self.config = config
        self.loss = TRPOLoss(policy, entropy_coeff=config.entropy_coeff)
        self.advantage = FiniteHorizonAdvantage(
            gamma=config.gamma,
            lmbda=config.lmbda,
            rollouts_per_context=rollouts_per_context,
            observation_map=policy.standardize,
            standardize=config.standardize,
        )
        self.optimizer = TrustRegionOptimizer(
            policy.parameters(),
            max_kl=config.max_kl,
            cg_iterations=config.cg_iterations,
            damping=config.damping,
        )

    def __call__(
        self, rollouts: TensorDictBase, extra_loss: Callable[[], Tensor] | None = None
    ) -> dict[str, float]:
        """Improve the policy on ``("next", "reward")`` of rollouts ``[N, T]``.

        Args:
            rollouts: as collected, with the distribution's parameters.
            extra_loss: () -> scalar, added to the surrogate loss, so that the trust region holds
                for the sum (imitation, for one).

        Returns:
            Metrics of the step.
        """
        batch = self.advantage(rollouts).select(*self.loss.in_keys).reshape(-1)
        acted = acted_steps(rollouts)
        if acted is not None:  # neither surrogate nor trust region see actions that did nothing
            batch = batch[acted.reshape(-1)]
        rows = torch.randint(batch.shape[0], (min(self.config.fisher_rows, batch.shape[0]),))
        fisher_batch = batch[rows]

        def closure() -> tuple[Tensor, Tensor]:
            losses = self.loss(batch)
            loss = losses["loss_objective"]
            return loss if extra_loss is None else loss + extra_loss(), losses["kl"]

        if has_closed_form(self.policy):
            product = gaussian_fisher_product(self.policy, fisher_batch)
            result = self.optimizer.step(closure, fisher_product=product)
        else:
            result = self.optimizer.step(closure, lambda: self.loss(fisher_batch)["kl"])
        scale = float(self.policy.log_scale.detach().exp().mean())
        # Under a name of its own where the learner alone moves it: a sign of failure reads it.
        learned = {"policy/learned_scale": scale} if self.policy.log_scale.requires_grad else {}
        return {
            **learned,
            "trpo/accepted": float(result.accepted),
            "trpo/kl": result.kl,
            "trpo/improvement": result.improvement,
            "trpo/backtracks": float(result.backtracks),
            "trpo/cg_residual": result.cg_residual,
            "trpo/gradient_norm": result.gradient_norm,
            "policy/scale": scale,
        }
