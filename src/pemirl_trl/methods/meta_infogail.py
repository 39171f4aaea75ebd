"""Meta-InfoGAIL, the paper's adversarial imitation baseline (Yu et al., 2019, Section 5)."""

from __future__ import annotations

from typing import Any

import torch
from pydantic.dataclasses import dataclass
from tensordict import TensorDictBase
from torch import Tensor
from torch.optim import Adam
from torchrl.envs import EnvBase

from pemirl_trl.configuration import CHECKED, Count, NonNegative
from pemirl_trl.functional import info_encoder_loss, normalized_within_context
from pemirl_trl.methods.adversarial import AdaptiveSampler, AdversarialConfig
from pemirl_trl.methods.collection import Collection
from pemirl_trl.modules import GAILDiscriminator, PEMIRLModel
from pemirl_trl.objectives import DiscriminatorLoss
from pemirl_trl.optim import descend


@dataclass(frozen=True, config=CHECKED)
class MetaInfoGAILConfig(AdversarialConfig):
    """Of Meta-InfoGAIL, beside what every adversarial method has.

    Attributes:
        discriminator_steps: Adam steps on D and psi per iteration.
        discriminator_lr, encoder_lr: of D and of psi.
        info_coeff: weight of log q(m | tau), in deviations of the batch, in the policy's reward.
        info_contexts: contexts per Adam step on psi, at most M.
    """

    discriminator_steps: Count = 10
    discriminator_lr: NonNegative = 1e-3
    encoder_lr: NonNegative = 1e-4
    info_coeff: NonNegative = 0.1
    info_contexts: Count = 10


class MetaInfoGAIL:
    """Meta-IL with a discriminator D(s, a), trained by the objective of InfoGAIL.

    The policy pi(a | s, m) maximises the discriminator's logit and, so that m keeps its meaning,
    lambda log q(m | tau) of each rollout; q ascends E log q(m | tau) (Li, Song and Ermon, 2017).
    D sees no context: it is the imitation term and q that tie m to a demonstration.

    Args:
        model: with ``reward="gail"``; encoder and policy commonly from Meta-IL.
        env: batch size ``[M K]``, with :class:`pemirl_trl.InferContext` over ``demonstrations``; or
            what collects such batches elsewhere (:class:`WorkerCollector`).
        demonstrations: batch size ``[J]``, leaves ``[J, T, ...]``; unlabelled.
        config: of the training.

    Raises:
        ValueError: the model's reward is no GAIL discriminator, or it has no contexts.
    """

    def __init__(
        self,
        model: PEMIRLModel,
        env: EnvBase | Collection,
        demonstrations: TensorDictBase,
        config: MetaInfoGAILConfig,
    ) -> None:
        if not isinstance(model.reward, GAILDiscriminator) or model.config.context_dim == 0:
            raise ValueError(
                'expected a model with contexts and reward="gail", got context_dim='
                f"{model.config.context_dim} and reward={model.config.reward!r}"
            )
        self.model, self.config = model, config
        self.iterations = config.iterations
        self.sampler = AdaptiveSampler(model, env, demonstrations, config)
        self._discriminator_loss = DiscriminatorLoss(model.reward)
        self._discriminator_optimizer = Adam(model.reward.parameters(), lr=config.discriminator_lr)
        self._encoder_optimizer = Adam(model.encoder.parameters(), lr=config.encoder_lr)

    @property
    def env_steps(self) -> int:
        """Environment steps so far."""
        return self.sampler.env_steps

    def iteration(self) -> dict[str, float]:
        """Collect; D classifies; psi explains the rollouts; omega follows both."""
        rollouts, metrics = self.sampler.collect()
        metrics |= self._update_discriminator_and_encoder(rollouts)
        return metrics | self.sampler.improve(rollouts, self._reward(rollouts))

    def _update_discriminator_and_encoder(self, rollouts: TensorDictBase) -> dict[str, float]:
        c = self.config
        contexts = rollouts.shape[0] // c.rollouts_per_context
        for _ in range(c.discriminator_steps):
            losses = self._discriminator_loss(self.sampler.discriminator_batch())
            descend(self._discriminator_optimizer, losses["loss_discriminator"])
            # One rollout of each of some contexts: psi needs no groups.
            rows = torch.randperm(contexts)[: c.info_contexts] * c.rollouts_per_context
            encoder_loss = info_encoder_loss(self._log_q(rollouts[rows]))
            descend(self._encoder_optimizer, encoder_loss)
        metrics = {f"discriminator/{k}": float(v.detach()) for k, v in losses.items()}
        return {**metrics, "info/log_q": -float(encoder_loss.detach())}

    def _log_q(self, rollouts: TensorDictBase) -> Tensor:
        """The posterior's log q(m | tau) of rollouts ``[N, T]``: ``[N]``, in nats."""
        trajectories = rollouts.select("observation", "action")
        trajectories.batch_size = rollouts.shape[:1]
        return self.model.encoder.get_dist(trajectories).log_prob(rollouts["context"][:, 0])

    @torch.no_grad()
    def _reward(self, rollouts: TensorDictBase) -> Tensor:
        """D's logit at each step, and T lambda log q(m | tau) at the last: ``[N, T, 1]``."""
        scored = self.model.reward(rollouts.select(*self.model.reward.in_keys))
        reward = scored["learned_reward"].clone()
        log_q = self._log_q(rollouts).view(-1, self.config.rollouts_per_context)
        bonus = normalized_within_context(log_q).view(-1, 1)
        reward[:, -1] += self.config.info_coeff * bonus * reward.shape[1]
        return reward

    def components(self) -> dict[str, Any]:
        """What a checkpoint holds."""
        return {
            "model": self.model,
            "discriminator_optimizer": self._discriminator_optimizer,
            "encoder_optimizer": self._encoder_optimizer,
            **self.sampler.components(),
        }
