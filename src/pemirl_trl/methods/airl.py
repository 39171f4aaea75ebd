"""Adversarial IRL (Fu, Luo and Levine, 2018), with whatever contexts its model infers."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from tensordict import TensorDictBase
from torch.optim import Adam
from torchrl.envs import EnvBase

from pemirl_trl.data import Negatives
from pemirl_trl.functional import PolicyReward
from pemirl_trl.methods.collection import EpisodeCollector
from pemirl_trl.methods.discriminator_batches import BatchConfig, DiscriminatorBatches
from pemirl_trl.methods.policy_improvement import (
    PolicyConfig,
    PolicyImprovement,
    learned_policy_reward,
)
from pemirl_trl.modules import AIRLDiscriminator, PEMIRLModel
from pemirl_trl.objectives import DiscriminatorLoss
from pemirl_trl.optim import descend


@dataclass(frozen=True)
class AIRLConfig:
    """Of adversarial IRL; every field means what it does in :class:`PEMIRLConfig`."""

    iterations: int = 100
    rollouts_per_context: int = 8
    policy_reward: PolicyReward = "state"
    reward_steps: int = 10
    reward_lr: float = 1e-3
    replay_iterations: int = 20
    batch: BatchConfig = field(default_factory=BatchConfig)
    gradient_penalty_coeff: float = 0.0
    policy: PolicyConfig = field(default_factory=PolicyConfig)


class AIRL:
    """Adversarial IRL; the encoder is never trained.

    With a model of context dimension 0 it is AIRL itself, one reward for all demonstrations. With
    contexts of an encoder that Meta-IL has trained it is PEMIRL without the information term.

    Args:
        model: r_theta, h_phi and pi_omega, trained in place; q_psi, used as it is.
        env: batch size ``[M K]``, with :class:`pemirl_trl.InferContext` over ``demonstrations``.
        demonstrations: batch size ``[J]``, leaves ``[J, T, ...]``; unlabelled.
        config: of the training.

    Raises:
        ValueError: the model has another kind of reward.
    """

    def __init__(
        self, model: PEMIRLModel, env: EnvBase, demonstrations: TensorDictBase, config: AIRLConfig
    ) -> None:
        if model.config.reward != "shaped":
            raise ValueError(
                f'AIRL needs a model with reward="shaped", got {model.config.reward!r}'
            )
        self.model, self.config = model, config
        self.iterations = config.iterations
        self.negatives = Negatives(config.replay_iterations)
        self._collect = EpisodeCollector(env, model.policy, model.horizon)
        self._batches = DiscriminatorBatches(
            model, demonstrations, self.negatives, config.batch, encoder_gradient=False
        )
        self._discriminator_loss = DiscriminatorLoss(
            AIRLDiscriminator(model.reward), gradient_penalty_coeff=config.gradient_penalty_coeff
        )
        self._reward_optimizer = Adam(model.reward.parameters(), lr=config.reward_lr)
        self._improve_policy = PolicyImprovement(
            model.policy, demonstrations, config.policy, config.rollouts_per_context
        )

    @property
    def env_steps(self) -> int:
        """Environment steps so far."""
        return self._collect.env_steps

    def iteration(self) -> dict[str, float]:
        """Collect; theta and phi classify expert from policy; omega follows r."""
        self._improve_policy.anneal(self._collect.progress(self.iterations))
        rollouts = self._collect()
        self.negatives.add(rollouts)
        metrics = {"return/true": float(rollouts["next", "reward"].sum(1).mean())}
        metrics |= self._update_reward()
        reward = learned_policy_reward(self.model.reward, rollouts, self.config.policy_reward)
        metrics |= self._improve_policy(rollouts, reward)
        return metrics

    def _update_reward(self) -> dict[str, float]:
        for _ in range(self.config.reward_steps):
            losses = self._discriminator_loss(self._batches.sample(self.config.replay_iterations))
            loss = losses["loss_discriminator"]
            if self.config.gradient_penalty_coeff > 0:
                loss = loss + losses["loss_gradient_penalty"]
            descend(self._reward_optimizer, loss)
        return {f"reward/{name}": float(value.detach()) for name, value in losses.items()}

    def components(self) -> dict[str, Any]:
        """What a checkpoint holds."""
        return {
            "model": self.model,
            "reward_optimizer": self._reward_optimizer,
            "negatives": self.negatives,
            "collector": self._collect,
        }
