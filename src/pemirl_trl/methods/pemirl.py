"""PEMIRL meta-training (Yu, Yu, Finn and Ermon, 2019, Algorithm 1)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import torch
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
from pemirl_trl.methods.schedule import log_linear
from pemirl_trl.modules import AIRLDiscriminator, PEMIRLModel
from pemirl_trl.objectives import DiscriminatorLoss, InfoLoss
from pemirl_trl.objectives.info import Summand
from pemirl_trl.optim import descend


@dataclass(frozen=True)
class PEMIRLConfig:
    """Of meta-training.

    Attributes:
        iterations: of Algorithm 1's loop.
        rollouts_per_context: K; the environment's batch holds M contexts of K rollouts each.
        policy_reward: what the policy maximises: ``"state"`` r, ``"shaped"`` f or ``"score"`` f -
            log pi.
        reward_steps: Adam steps on psi, theta and phi per iteration.
        reward_lr, encoder_lr: of theta and phi, and of psi.
        final_reward_lr: to which ``reward_lr`` shrinks, log-linearly, while the policy is annealed
            (``policy.anneal_from``); None holds it. An extension of the paper: next to a policy
            that has become precise, classification says little about states farther off, and a
            reward that keeps learning forgets them.
        replay_iterations: how many iterations of rollouts serve as negatives.
        batch: of the discriminator.
        gradient_penalty_coeff: R1 penalty on r; an extension of the paper, 0 is off.
        encoder_gradient: whether the discriminator's loss also trains psi (the authors' code).
        info_coeff: weight of L_info beside the classification loss, for theta.
        info_contexts: contexts per Adam step from which L_info is estimated.
        info_summand, info_time_mean, info_normalize: see :class:`InfoLoss`.
        policy: of the policy's side.
    """

    iterations: int = 100
    rollouts_per_context: int = 8
    policy_reward: PolicyReward = "state"
    reward_steps: int = 10
    reward_lr: float = 1e-3
    final_reward_lr: float | None = None
    encoder_lr: float = 1e-4
    replay_iterations: int = 20
    batch: BatchConfig = field(default_factory=BatchConfig)
    gradient_penalty_coeff: float = 0.0
    encoder_gradient: bool = False
    info_coeff: float = 0.1
    info_contexts: int = 10
    info_summand: Summand = "shaped"
    info_time_mean: bool = False
    info_normalize: bool = False
    policy: PolicyConfig = field(default_factory=PolicyConfig)


class PEMIRL:
    """Algorithm 1 on a TorchRL environment that writes ``context`` at reset.

    Args:
        model: q_psi, r_theta, h_phi and pi_omega, trained in place; q_psi commonly initialised by
            Meta-IL and pi_omega fresh.
        env: batch size ``[M K]``, with :class:`pemirl_trl.InferContext` over ``demonstrations``.
        demonstrations: batch size ``[J]``, leaves ``[J, T, ...]``; unlabelled.
        config: of the training.
        info_loss: another estimator of the information term, with :class:`InfoLoss`'s interface,
            for comparisons; None takes Lemma 2's.

    Raises:
        ValueError: the model has no contexts (that is :class:`AIRL`), or another kind of reward.
    """

    def __init__(
        self,
        model: PEMIRLModel,
        env: EnvBase,
        demonstrations: TensorDictBase,
        config: PEMIRLConfig,
        *,
        info_loss: Callable[[TensorDictBase], TensorDictBase] | None = None,
    ) -> None:
        if model.config.context_dim == 0 or model.config.reward != "shaped":
            raise ValueError(
                'PEMIRL needs a model with contexts and reward="shaped"; got context_dim='
                f"{model.config.context_dim} and reward={model.config.reward!r}"
            )
        self.model, self.config = model, config
        self.iterations = config.iterations
        self.negatives = Negatives(config.replay_iterations)
        self._collect = EpisodeCollector(env, model.policy, model.horizon)
        self._batches = DiscriminatorBatches(
            model,
            demonstrations,
            self.negatives,
            config.batch,
            encoder_gradient=config.encoder_gradient,
        )
        self._info_loss = info_loss or InfoLoss(
            model.encoder,
            model.reward,
            rollouts_per_context=config.rollouts_per_context,
            summand=config.info_summand,
            time_mean=config.info_time_mean,
            normalize=config.info_normalize,
        )
        self._discriminator_loss = DiscriminatorLoss(
            AIRLDiscriminator(model.reward),
            detach_context=not config.encoder_gradient,
            gradient_penalty_coeff=config.gradient_penalty_coeff,
        )
        self._encoder_optimizer = Adam(model.encoder.parameters(), lr=config.encoder_lr)
        self._reward_optimizer = Adam(model.reward.parameters(), lr=config.reward_lr)
        self._improve_policy = PolicyImprovement(
            model.policy, demonstrations, config.policy, config.rollouts_per_context
        )

    @property
    def env_steps(self) -> int:
        """Environment steps so far."""
        return self._collect.env_steps

    def iteration(self) -> dict[str, float]:
        """One pass of Algorithm 1's loop, in its order."""
        self._anneal(self._collect.progress(self.iterations))
        # tau_E ~ D_E, m ~ q(m|tau_E), tau ~ pi(tau|m): the environment draws m at its reset.
        rollouts = self._collect()
        self.negatives.add(rollouts)
        metrics = {"return/true": float(rollouts["next", "reward"].sum(1).mean())}
        # psi to increase L_info; theta to increase L_info and to classify expert from policy.
        metrics |= self._update_encoder_and_reward(rollouts)
        # omega to increase the learned reward, within a trust region.
        reward = learned_policy_reward(self.model.reward, rollouts, self.config.policy_reward)
        metrics |= self._improve_policy(rollouts, reward)
        return metrics

    def _anneal(self, progress: float) -> None:
        c = self.config
        self._improve_policy.anneal(progress)
        if c.final_reward_lr is not None:
            begin = c.policy.anneal_from
            lr = log_linear(c.reward_lr, c.final_reward_lr, progress, begin=begin)
            self._reward_optimizer.param_groups[0]["lr"] = lr

    def _update_encoder_and_reward(self, rollouts: TensorDictBase) -> dict[str, float]:
        c = self.config
        for _ in range(c.reward_steps):
            info = self._info_loss(self._some_contexts(rollouts))
            classification = self._discriminator_loss(self._batches.sample(c.replay_iterations))
            # Both losses are computed before either step: psi and theta move simultaneously.
            psi_loss = info["loss_info_encoder"]
            theta_loss = classification["loss_discriminator"]
            if c.encoder_gradient:
                psi_loss = psi_loss + theta_loss
            theta_loss = theta_loss + c.info_coeff * info["loss_info_reward"]
            if c.gradient_penalty_coeff > 0:
                theta_loss = theta_loss + classification["loss_gradient_penalty"]
            descend(self._encoder_optimizer, psi_loss, retain_graph=c.encoder_gradient)
            descend(self._reward_optimizer, theta_loss)
        losses = {**info, **classification}
        return {f"reward/{name}": float(value.detach()) for name, value in losses.items()}

    def _some_contexts(self, rollouts: TensorDictBase) -> TensorDictBase:
        k = self.config.rollouts_per_context
        count = rollouts.shape[0] // k
        chosen = torch.randperm(count)[: self.config.info_contexts]
        rows = (chosen.unsqueeze(-1) * k + torch.arange(k)).reshape(-1)
        keys = ("observation", "action", ("next", "observation"), "context", "demonstration")
        return rollouts.select(*keys)[rows]

    def components(self) -> dict[str, Any]:
        """What a checkpoint holds."""
        return {
            "model": self.model,
            "encoder_optimizer": self._encoder_optimizer,
            "reward_optimizer": self._reward_optimizer,
            "negatives": self.negatives,
            "collector": self._collect,
        }
