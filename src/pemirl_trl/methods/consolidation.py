"""Reward consolidation: settle r against a target that stands still. An extension of the paper.

During meta-training the reward chases a policy that chases the reward, and the peak of r(s, m)
wanders by centimetres even while the policy's return improves. Here policy and encoder are frozen,
so the classification problem stands still; blurred negatives enclose the expert's support, and the
R1 penalty keeps a global slope.
No environment step is taken and no ground truth is read.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from tensordict import TensorDictBase
from torch.optim import Adam
from torch.optim.lr_scheduler import ExponentialLR

from pemirl_trl.data import Negatives
from pemirl_trl.methods.discriminator_batches import BatchConfig, DiscriminatorBatches
from pemirl_trl.methods.loop import iteration_count
from pemirl_trl.modules import AIRLDiscriminator, PEMIRLModel
from pemirl_trl.objectives import DiscriminatorLoss
from pemirl_trl.optim import descend


@dataclass(frozen=True)
class ConsolidationConfig:
    """Of the consolidation.

    Attributes:
        steps: Adam steps in all, a multiple of ``steps_per_iteration``.
        steps_per_iteration: how many of them one iteration does.
        lr, final_lr: the learning rate decays exponentially from one to the other.
        gradient_penalty_coeff: R1 penalty on r.
        batch: of the discriminator.
    """

    steps: int = 2500
    steps_per_iteration: int = 100
    lr: float = 1e-3
    final_lr: float = 1e-4
    gradient_penalty_coeff: float = 0.01
    batch: BatchConfig = field(
        default_factory=lambda: BatchConfig(
            current_fraction=0.0, jitter_fraction=0.7, jitter_scale=1.5
        )
    )


class Consolidation:
    """Train theta and phi alone on frozen q_psi, pi_omega and rollouts.

    Args:
        model: its reward is trained in place.
        demonstrations: batch size ``[J]``, leaves ``[J, T, ...]``.
        negatives: rollouts of meta-training; all that it holds are used.
        config: of the training.
    """

    def __init__(
        self,
        model: PEMIRLModel,
        demonstrations: TensorDictBase,
        negatives: Negatives,
        config: ConsolidationConfig,
    ) -> None:
        self.model, self.config, self.negatives = model, config, negatives
        self.iterations = iteration_count(config.steps, config.steps_per_iteration)
        self.env_steps = 0
        self._batches = DiscriminatorBatches(model, demonstrations, negatives, config.batch)
        self._loss = DiscriminatorLoss(
            AIRLDiscriminator(model.reward), gradient_penalty_coeff=config.gradient_penalty_coeff
        )
        self._optimizer = Adam(model.reward.parameters(), lr=config.lr)
        decay = (config.final_lr / config.lr) ** (1 / config.steps)
        self._schedule = ExponentialLR(self._optimizer, decay)

    def iteration(self) -> dict[str, float]:
        """So many Adam steps."""
        c = self.config
        for _ in range(c.steps_per_iteration):
            losses = self._loss(self._batches.sample(last=len(self.negatives)))
            loss = losses["loss_discriminator"]
            if c.gradient_penalty_coeff > 0:
                loss = loss + losses["loss_gradient_penalty"]
            descend(self._optimizer, loss)
            self._schedule.step()
        return {f"consolidation/{k}": float(v.detach()) for k, v in losses.items()}

    def components(self) -> dict[str, Any]:
        """What a checkpoint holds."""
        return {
            "reward": self.model.reward,
            "optimizer": self._optimizer,
            "schedule": self._schedule,
        }
