"""PEMIRL meta-training (Yu, Yu, Finn and Ermon, 2019, Algorithm 1)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Annotated, Any

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass
from tensordict import TensorDictBase
from torch import Tensor
from torch.optim import Adam
from torchrl.envs import EnvBase

from pemirl_trl.configuration import CHECKED, Count, NonNegative
from pemirl_trl.methods.adversarial import AdaptiveSampler, PolicyConfig, learned_policy_reward
from pemirl_trl.methods.airl import AIRLConfig, set_learning_rate
from pemirl_trl.methods.collection import Collection
from pemirl_trl.methods.discriminator_batches import BatchConfig
from pemirl_trl.methods.trpo import TRPOConfig
from pemirl_trl.modules import AIRLDiscriminator, PEMIRLModel
from pemirl_trl.objectives import DiscriminatorLoss, InfoLoss
from pemirl_trl.objectives.info import Form, Summand
from pemirl_trl.optim import descend

INFORMING = ("observation", "action", ("next", "observation"), "context", "demonstration")


@dataclass(frozen=True, config=CHECKED)
class PEMIRLConfig(AIRLConfig):
    """Of meta-training, beside what adversarial IRL has.

    The defaults are the paper's method, with settings that hold on every domain
    (:meth:`paper`).

    Attributes:
        encoder_lr: of psi; 0 leaves it as it is.
        encoder_gradient: whether the discriminator's loss also trains psi (the authors' code).
        info_coeff: weight of L_info beside the classification loss, for theta.
        info_contexts: contexts per Adam step from which L_info is estimated, at most M.
        info_summand, info_time_mean, info_normalize, info_form, info_prior_fraction: see
            :class:`InfoLoss`.
    """

    encoder_lr: NonNegative = 0.0
    encoder_gradient: bool = False
    info_coeff: NonNegative = 0.1
    info_contexts: Count = 10
    info_summand: Summand = "shaped"
    info_time_mean: bool = True
    info_normalize: bool = False
    info_form: Form = "tilted"
    info_prior_fraction: Annotated[float, Field(ge=0, lt=1)] = 0.01

    @classmethod
    def paper(cls) -> PEMIRLConfig:
        """Algorithm 1 with settings that hold on every domain: the defaults.

        The information term has the paper's weight of 0.1, in a form that is bounded (tilted, with
        q mixed with the prior): rescaled, it drives r without end where the discriminator is
        saturated. psi does not follow it: on the ant the contexts that q then gives move faster
        than the policy follows. It goes with a deviation that the policy learns
        (``learn_policy_scale``) and no bonus on entropy: a deviation held at 1 caps what any
        policy can do, and with actions that the simulator clamps entropy costs nothing.
        """
        return cls()

    @classmethod
    def literal(cls) -> PEMIRLConfig:
        """Algorithm 1 to the letter, wherever the paper gives a value.

        L_info as Lemma 2 has it, unscaled, with weight 0.1; psi follows it at Adam's default rate;
        the policy maximises log D - log(1 - D), with an entropy weight of 0.1 (the paper's of
        Point-Maze is 1.0). Made for comparison: it does not hold up (docs/method.md).
        """
        return cls(
            encoder_lr=1e-3,
            info_time_mean=False,
            info_form="covariance",
            info_prior_fraction=0.0,
            policy_reward="score",
            policy=PolicyConfig(trpo=TRPOConfig(entropy_coeff=0.1)),
        )

    @classmethod
    def rescaled(cls) -> PEMIRLConfig:
        """Point-Maze's settings of old: log q in deviations of the batch, r's return by T.

        It goes with a deviation that is held at 1, and fails on bodies with many joints: nothing
        opposes the rescaled term where the discriminator is saturated.
        """
        return cls(
            encoder_lr=1e-4,
            info_coeff=0.03,
            info_normalize=True,
            info_form="covariance",
            info_prior_fraction=0.0,
        )

    @classmethod
    def robust(cls) -> PEMIRLConfig:
        """An extension, for rewards that train new policies far from the demonstrations.

        Half of the policy's trajectories in a discriminator batch are blurred by Gaussian noise, in
        units of the observations' spread, and r carries an R1 penalty in the same units: blurred
        negatives enclose the expert's support, the penalty keeps a global slope. For half of the
        iterations the policy explores with a deviation of 1 while the reward takes shape; then the
        reward's learning rate fades out, and the policy acts ever more precisely, with a growing
        weight on imitation. The information term is :meth:`rescaled`'s.
        """
        return replace(
            cls.rescaled(),
            final_reward_lr=1e-4,
            gradient_penalty_coeff=0.1,
            batch=BatchConfig(jitter_fraction=0.5, jitter_scale=2.0),
            policy=PolicyConfig(final_scale=0.3, final_imitation_coeff=1.0),
        )

    @classmethod
    def contrastive(cls) -> PEMIRLConfig:
        """An extension, for bodies that have to move differently where the dynamics have changed.

        On top of :meth:`robust`, half of the discriminator's negatives are demonstrations under the
        context of another one, so that r asks which task is being done, and not for what all tasks
        have in common; and log pi is taken relative to the policy's density at its mean: with many
        action components and a deviation that is annealed, r would otherwise chase a constant that
        grows by eight to ten nats, and tilt. There is no information term: these negatives already
        tie r to the context (their optimum is the pointwise mutual information of transition and
        context), and q stays what Meta-IL made of it. See docs/robust_rewards.md.
        """
        robust = cls.robust()
        batch = replace(robust.batch, mismatched_fraction=0.5, relative_log_prob=True)
        return replace(robust, info_coeff=0.0, encoder_lr=0.0, batch=batch)


class PEMIRL:
    """Algorithm 1 on a TorchRL environment that writes ``context`` at reset.

    Args:
        model: q_psi, r_theta, h_phi and pi_omega, trained in place; q_psi commonly initialised by
            Meta-IL and pi_omega fresh.
        env: batch size ``[M K]``, with :class:`pemirl_trl.InferContext` over ``demonstrations``; or
            what collects such batches elsewhere (:class:`WorkerCollector`).
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
        env: EnvBase | Collection,
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
        self.sampler = AdaptiveSampler(
            model,
            env,
            demonstrations,
            config,
            encoder_gradient=config.encoder_gradient,
            encoder_held=config.encoder_lr == 0 and not config.encoder_gradient,
        )
        self._info_loss = info_loss or InfoLoss(
            model.encoder,
            model.reward,
            rollouts_per_context=config.rollouts_per_context,
            summand=config.info_summand,
            time_mean=config.info_time_mean,
            normalize=config.info_normalize,
            form=config.info_form,
            prior_fraction=config.info_prior_fraction,
        )
        self._discriminator_loss = DiscriminatorLoss(
            AIRLDiscriminator(model.reward),
            detach_context=not config.encoder_gradient,
            gradient_penalty_coeff=config.gradient_penalty_coeff,
        )
        self._encoder_optimizer = Adam(model.encoder.parameters(), lr=config.encoder_lr)
        self._reward_optimizer = Adam(model.reward.parameters(), lr=config.reward_lr)

    @property
    def env_steps(self) -> int:
        """Environment steps so far."""
        return self.sampler.env_steps

    def iteration(self) -> dict[str, float]:
        """One pass of Algorithm 1's loop, in its order."""
        c = self.config
        set_learning_rate(
            self._reward_optimizer, self.sampler.annealed(c.reward_lr, c.final_reward_lr)
        )
        # tau_E ~ D_E, m ~ q(m|tau_E), tau ~ pi(tau|m): the environment draws m at its reset.
        rollouts, metrics = self.sampler.collect()
        # psi to increase L_info; theta to increase L_info and to classify expert from policy.
        metrics |= self._update_encoder_and_reward(rollouts)
        # omega to increase the learned reward, within a trust region.
        reward = learned_policy_reward(self.model.reward, rollouts, c.policy_reward)
        return metrics | self.sampler.improve(rollouts, reward)

    def _update_encoder_and_reward(self, rollouts: TensorDictBase) -> dict[str, float]:
        c = self.config
        # With a rate of 0 psi stays where it is, and with a weight of 0 theta does not hear of it.
        moves_psi, informs_theta = c.encoder_lr > 0, c.info_coeff > 0
        for step in range(1, c.reward_steps + 1):
            rows = self._rows_of_some_contexts(rollouts)
            if moves_psi or informs_theta or step == c.reward_steps:  # the last one for the metrics
                with torch.set_grad_enabled(moves_psi or informs_theta):
                    info = self._info_loss(rollouts.select(*INFORMING)[rows])
            classification = self._discriminator_loss(self.sampler.discriminator_batch())
            # Both losses are computed before either step: psi and theta move simultaneously.
            theta_loss = classification["loss_discriminator"]
            if moves_psi:
                psi_loss = info["loss_info_encoder"] + (theta_loss if c.encoder_gradient else 0.0)
            if informs_theta:
                theta_loss = theta_loss + c.info_coeff * info["loss_info_reward"]
            if c.gradient_penalty_coeff > 0:
                theta_loss = theta_loss + classification["loss_gradient_penalty"]
            if moves_psi:
                descend(self._encoder_optimizer, psi_loss, retain_graph=c.encoder_gradient)
            descend(self._reward_optimizer, theta_loss)
        losses = {**info, **classification}
        return {f"reward/{name}": float(value.detach()) for name, value in losses.items()}

    def _rows_of_some_contexts(self, rollouts: TensorDictBase) -> Tensor:
        k = self.config.rollouts_per_context
        count = rollouts.shape[0] // k
        chosen = torch.randperm(count)[: self.config.info_contexts]
        return (chosen.unsqueeze(-1) * k + torch.arange(k)).reshape(-1)

    def components(self) -> dict[str, Any]:
        """What a checkpoint holds."""
        return {
            "model": self.model,
            "encoder_optimizer": self._encoder_optimizer,
            "reward_optimizer": self._reward_optimizer,
            **self.sampler.components(),
        }
