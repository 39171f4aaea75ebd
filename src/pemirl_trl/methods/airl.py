"""Adversarial IRL (Fu, Luo and Levine, 2018), with whatever contexts its model infers."""

from __future__ import annotations

from typing import Any

from pydantic.dataclasses import dataclass
from tensordict import TensorDictBase
from torch.optim import Adam
from torchrl.envs import EnvBase

from pemirl_trl.configuration import CHECKED, Count, NonNegative, Positive
from pemirl_trl.functional import PolicyReward
from pemirl_trl.methods.adversarial import AdaptiveSampler, AdversarialConfig, learned_policy_reward
from pemirl_trl.methods.collection import Collection
from pemirl_trl.modules import AIRLDiscriminator, PEMIRLModel
from pemirl_trl.objectives import DiscriminatorLoss
from pemirl_trl.optim import descend


@dataclass(frozen=True, config=CHECKED)
class AIRLConfig(AdversarialConfig):
    """Of adversarial IRL, beside what every adversarial method has.

    Attributes:
        policy_reward: what the policy maximises: ``"state"`` r, ``"shaped"`` f or ``"score"`` f -
            log pi.
        reward_steps: Adam steps on theta and phi per iteration.
        reward_lr: of theta and phi.
        final_reward_lr: to which ``reward_lr`` shrinks, log-linearly, while the policy is annealed;
            None holds it. An extension of the paper: next to a policy that has become precise,
            classification says little about states farther off, and a reward that keeps learning
            forgets them.
        gradient_penalty_coeff: R1 penalty on r; an extension of the paper, 0 is off.
    """

    policy_reward: PolicyReward = "state"
    reward_steps: Count = 10
    reward_lr: NonNegative = 1e-3
    final_reward_lr: Positive | None = None
    gradient_penalty_coeff: NonNegative = 0.0


class AIRL:
    """Adversarial IRL; the encoder is never trained.

    With a model of context dimension 0 it is AIRL itself, one reward for all demonstrations. With
    contexts of an encoder that Meta-IL has trained it is PEMIRL without the information term.

    Args:
        model: r_theta, h_phi and pi_omega, trained in place; q_psi, used as it is.
        env: batch size ``[M K]``, with :class:`pemirl_trl.InferContext` over ``demonstrations``; or
            what collects such batches elsewhere (:class:`WorkerCollector`).
        demonstrations: batch size ``[J]``, leaves ``[J, T, ...]``; unlabelled.
        config: of the training.

    Raises:
        ValueError: the model has another kind of reward.
    """

    def __init__(
        self,
        model: PEMIRLModel,
        env: EnvBase | Collection,
        demonstrations: TensorDictBase,
        config: AIRLConfig,
    ) -> None:
        if model.config.reward != "shaped":
            raise ValueError(
                f'AIRL needs a model with reward="shaped", got {model.config.reward!r}'
            )
        self.model, self.config = model, config
        self.iterations = config.iterations
        self.sampler = AdaptiveSampler(model, env, demonstrations, config)
        self._discriminator_loss = DiscriminatorLoss(
            AIRLDiscriminator(model.reward), gradient_penalty_coeff=config.gradient_penalty_coeff
        )
        self._reward_optimizer = Adam(model.reward.parameters(), lr=config.reward_lr)

    @property
    def env_steps(self) -> int:
        """Environment steps so far."""
        return self.sampler.env_steps

    def iteration(self) -> dict[str, float]:
        """Collect; theta and phi classify expert from policy; omega follows r."""
        c = self.config
        set_learning_rate(
            self._reward_optimizer, self.sampler.annealed(c.reward_lr, c.final_reward_lr)
        )
        rollouts, metrics = self.sampler.collect()
        metrics |= self._update_reward()
        reward = learned_policy_reward(self.model.reward, rollouts, c.policy_reward)
        return metrics | self.sampler.improve(rollouts, reward)

    def _update_reward(self) -> dict[str, float]:
        for _ in range(self.config.reward_steps):
            losses = self._discriminator_loss(self.sampler.discriminator_batch())
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
            **self.sampler.components(),
        }


def set_learning_rate(optimizer: Adam, lr: float) -> None:
    """The learning rate of all of an optimiser's parameters from now on."""
    for group in optimizer.param_groups:
        group["lr"] = lr
