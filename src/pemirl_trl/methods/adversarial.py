"""What every adversarial method shares: the adaptive sampler pi_omega and the discriminator's data.

The methods (:mod:`pemirl_trl.methods.pemirl`, ``airl`` and ``meta_infogail``) hold the order of
updates; this holds their common parts, once.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import field
from typing import Any

import torch
from pydantic.dataclasses import dataclass
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from pemirl_trl.configuration import CHECKED, Count, NonNegative, Positive, Share
from pemirl_trl.data import Negatives
from pemirl_trl.functional import PolicyReward, policy_reward
from pemirl_trl.methods.collection import Collection, collection
from pemirl_trl.methods.diagnostics import Diagnostics
from pemirl_trl.methods.discriminator_batches import BatchConfig, DiscriminatorBatches
from pemirl_trl.methods.schedule import AnnealedScale, log_linear
from pemirl_trl.methods.trpo import TRPO, TRPOConfig
from pemirl_trl.modules import PEMIRLModel, ShapedReward
from pemirl_trl.modules.network import device_of
from pemirl_trl.modules.reading import acted_steps


@dataclass(frozen=True, config=CHECKED)
class PolicyConfig:
    """Of the policy's side of an adversarial method.

    Attributes:
        trpo: of one update.
        imitation_coeff: weight of the demonstrations' log-likelihood per step, in nats; 0 is off.
        final_imitation_coeff: to which that weight grows; None holds it.
        final_scale: to which the policy's deviation shrinks (of discrete actions, the uniform
            share); None leaves it to the policy.
        anneal_begin, anneal_finish: shares of the iterations between which weight and deviation
            move, log-linearly. An extension of the paper: the reward is learned against an
            exploring policy, and the policy that is kept acts precisely.
    """

    trpo: TRPOConfig = field(default_factory=TRPOConfig)
    imitation_coeff: NonNegative = 0.01
    final_imitation_coeff: Positive | None = None
    final_scale: Positive | None = None
    anneal_begin: Share = 0.5
    anneal_finish: Share = 1.0

    def __post_init__(self) -> None:
        if not self.anneal_begin < self.anneal_finish:
            raise ValueError(
                f"anneal_begin is {self.anneal_begin} and anneal_finish {self.anneal_finish}; "
                "expected the first to be smaller"
            )
        if self.final_imitation_coeff is not None and self.imitation_coeff == 0:
            raise ValueError("final_imitation_coeff needs an imitation_coeff above 0 to grow from")


@dataclass(frozen=True, config=CHECKED)
class AdversarialConfig:
    """Of every adversarial method.

    Attributes:
        iterations: of the loop.
        rollouts_per_context: K; the environment's batch holds M contexts of K rollouts each.
        replay_iterations: how many iterations of rollouts serve as negatives (the paper: 20).
        batch: of the discriminator.
        policy: of the policy's side.
    """

    iterations: Count = 50
    rollouts_per_context: Count = 16
    replay_iterations: Count = 20
    batch: BatchConfig = field(default_factory=BatchConfig)
    policy: PolicyConfig = field(default_factory=PolicyConfig)


class AdaptiveSampler:
    """pi_omega with all that it collects: rollouts, negatives and its own trust-region update.

    Args:
        model: its policy is moved in place.
        env: batch size ``[M K]``, with :class:`pemirl_trl.InferContext` over ``demonstrations``; or
            what collects such batches elsewhere (:class:`WorkerCollector`).
        demonstrations: batch size ``[J]``, leaves ``[J, T, ...]``; unlabelled.
        config: of the method.
        encoder_gradient: whether the expert's m carries gradients to the encoder.
        encoder_held: whether the method leaves the encoder as it is.
    """

    def __init__(
        self,
        model: PEMIRLModel,
        env: EnvBase | Collection,
        demonstrations: TensorDictBase,
        config: AdversarialConfig,
        *,
        encoder_gradient: bool = False,
        encoder_held: bool = False,
    ) -> None:
        self.policy, self.config = model.policy, config
        self.demonstrations = demonstrations = demonstrations.to(device_of(model))
        self.negatives = Negatives(config.replay_iterations)
        self.imitation_coeff = config.policy.imitation_coeff
        self._collect = collection(env, model.policy, model.horizon)
        self._batches = DiscriminatorBatches(
            model,
            demonstrations,
            self.negatives,
            config.batch,
            encoder_gradient=encoder_gradient,
            encoder_held=encoder_held,
        )
        stretch = (config.policy.anneal_begin, config.policy.anneal_finish)
        self._scale = AnnealedScale(self.policy.log_scale, config.policy.final_scale, *stretch)
        self._update = TRPO(self.policy, config.policy.trpo, config.rollouts_per_context)
        self._diagnostics = Diagnostics(model, demonstrations, config.rollouts_per_context)

    @property
    def env_steps(self) -> int:
        """Environment steps so far."""
        return self._collect.env_steps

    @property
    def progress(self) -> float:
        """Where the next iteration stands, from 0 for the first to 1 for the last."""
        return self._collect.progress(self.config.iterations)

    def annealed(self, start: float, end: float | None) -> float:
        """A number of the method that moves when the policy does; ``end`` None holds it."""
        if end is None:
            return start
        c = self.config.policy
        return log_linear(start, end, self.progress, begin=c.anneal_begin, finish=c.anneal_finish)

    def collect(self) -> tuple[TensorDictBase, dict[str, float]]:
        """Rollouts ``[N, T]`` of the policy of now, kept as negatives; and their true return."""
        c = self.config.policy
        self._scale.move(self.progress)
        self.imitation_coeff = self.annealed(c.imitation_coeff, c.final_imitation_coeff)
        rollouts = self._collect()
        self.negatives.add(rollouts)
        return rollouts, self._collect.true_return(rollouts)

    def discriminator_batch(self) -> TensorDict:
        """Expert and policy transitions in equal number; see :class:`DiscriminatorBatches`."""
        return self._batches.sample(self.config.replay_iterations)

    def improve(self, rollouts: TensorDictBase, reward: Tensor) -> dict[str, float]:
        """One trust-region update on ``reward`` ``[N, T, 1]`` of rollouts ``[N, T]``; metrics.

        The imitation term is inside the trust region.
        """
        health = self._diagnostics(rollouts, reward)
        metrics = self._update(
            rollouts.copy().set(("next", "reward"), reward), self.imitation_loss(rollouts)
        )
        learned = {
            "return/learned": float(reward.sum(1).mean()),
            "reward/magnitude": float(reward.abs().mean()),
        }
        return {**learned, **health, **metrics}

    def imitation_loss(self, rollouts: TensorDictBase) -> Callable[[], Tensor] | None:
        """() -> minus the weighted log-likelihood of the rollouts' demonstrations.

        Of each demonstration under pi(a | s, m), with the m that was drawn from it for the rollouts
        (Yu et al., 2019, Appendix E.3).
        """
        if self.imitation_coeff == 0:
            return None
        first = rollouts[:: self.config.rollouts_per_context]  # one row per context
        demonstrations = self.demonstrations[first["demonstration"][:, 0]]
        batch = TensorDict(
            {"observation": demonstrations["observation"], "context": first["context"]},
            first.shape,
        ).reshape(-1)
        action = demonstrations["action"].flatten(0, 1)
        acted = acted_steps(demonstrations)
        if acted is not None:
            batch, action = batch[acted.flatten()], action[acted.flatten()]

        def loss() -> Tensor:
            log_prob = self.policy.get_dist(batch.copy()).log_prob(action)
            return -self.imitation_coeff * log_prob.mean()

        return loss

    def components(self) -> dict[str, Any]:
        """What a checkpoint holds, beside the model and the optimisers."""
        return {"negatives": self.negatives, "collector": self._collect}


@torch.no_grad()
def learned_policy_reward(
    reward: ShapedReward, rollouts: TensorDictBase, kind: PolicyReward
) -> Tensor:
    """What the policy maximises of the learned reward, ``[N, T, 1]``; see ``policy_reward``."""
    keys = [reward.observation_key, reward.context_key]
    if kind != "state":  # r needs no next observation; the potentials' time is saved
        keys.insert(1, reward.next_observation_key)
    scored = reward(rollouts.select(*keys))
    state = scored[reward.reward_key]
    shaped = scored.get(reward.shaped_reward_key, state)
    return policy_reward(state, shaped, rollouts["action_log_prob"].unsqueeze(-1), kind)
