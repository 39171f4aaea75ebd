"""Reward consolidation: settle r against a target that stands still. An extension of the paper.

During meta-training the reward chases a policy that chases the reward, and the peak of r(s, m)
wanders by centimetres even while the policy's return improves. Here policy and encoder are frozen,
so the classification problem stands still; blurred negatives enclose the expert's support, the R1
penalty keeps a global slope, and r is averaged over the end of the training.
No environment step is taken and no ground truth is read.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from typing import Any

from tensordict import TensorDictBase
from torch.optim import Adam
from torch.optim.lr_scheduler import ExponentialLR

from pemirl_trl.data import Negatives
from pemirl_trl.methods.discriminator_batches import BatchConfig, DiscriminatorBatches
from pemirl_trl.modules import AIRLDiscriminator, AveragedReward, PEMIRLModel
from pemirl_trl.modules.reward import ShapedReward
from pemirl_trl.objectives import DiscriminatorLoss
from pemirl_trl.optim import descend


@dataclass(frozen=True)
class ConsolidationConfig:
    """Of the consolidation.

    Attributes:
        steps: Adam steps in all.
        steps_per_iteration: how many of them one iteration does.
        lr, final_lr: the learning rate decays exponentially from one to the other.
        gradient_penalty_coeff: R1 penalty on r.
        batch: of the discriminator.
        average_fraction: the last part of the steps over which r is averaged.
        average_every: steps between the snapshots that are averaged.
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
    average_fraction: float = 0.25
    average_every: int = 20


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
        self.iterations = max(1, config.steps // config.steps_per_iteration)
        self.env_steps = 0
        self._batches = DiscriminatorBatches(model, demonstrations, negatives, config.batch)
        self._loss = DiscriminatorLoss(
            AIRLDiscriminator(model.reward), gradient_penalty_coeff=config.gradient_penalty_coeff
        )
        self._optimizer = Adam(model.reward.parameters(), lr=config.lr)
        decay = (config.final_lr / config.lr) ** (1 / config.steps)
        self._schedule = ExponentialLR(self._optimizer, decay)
        self._snapshots: list[ShapedReward] = []
        self._done = 0

    def iteration(self) -> dict[str, float]:
        """So many Adam steps, with a snapshot of r now and then towards the end."""
        c = self.config
        for _ in range(c.steps_per_iteration):
            losses = self._loss(self._batches.sample(last=len(self.negatives)))
            loss = losses["loss_discriminator"]
            if c.gradient_penalty_coeff > 0:
                loss = loss + losses["loss_gradient_penalty"]
            descend(self._optimizer, loss)
            self._schedule.step()
            self._done += 1
            late = self._done > (1 - c.average_fraction) * c.steps
            if late and self._done % c.average_every == 0:
                self._snapshots.append(copy.deepcopy(self.model.reward))
        return {f"consolidation/{k}": float(v.detach()) for k, v in losses.items()}

    def averaged_reward(self) -> AveragedReward:
        """The mean of the snapshots, as a function."""
        return AveragedReward(self._snapshots or [self.model.reward])

    def components(self) -> dict[str, Any]:
        """What a checkpoint holds."""
        return {
            "reward": self.model.reward,
            "optimizer": self._optimizer,
            "schedule": self._schedule,
        }
