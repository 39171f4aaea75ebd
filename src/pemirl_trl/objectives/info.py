"""The mutual information between context and trajectory, for the encoder and for the reward."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import ProbabilisticTensorDictSequential, TensorDictParams, dispatch
from tensordict.utils import NestedKey
from torch import Tensor
from torch.distributions import Normal

from pemirl_trl.functional import (
    info_encoder_loss,
    info_reward_loss,
    mixed_with_prior,
    tilted_info_reward_loss,
)
from pemirl_trl.modules import ShapedReward
from pemirl_trl.modules.reading import ENCODER, REWARD
from pemirl_trl.objectives.common import KeyedLoss, per_rollout, require_time

Summand = Literal["shaped", "state"]
Form = Literal["covariance", "tilted"]


class InfoLoss(KeyedLoss):
    r"""The mutual information L_info = E log q_psi(m|tau) over the policy's rollouts, two losses.

    - ``loss_info_encoder`` = -mean log q_psi(m|tau), with m the context that produced the rollout,
      as data: its gradient reaches psi alone (Equation 7 of Yu, Yu, Finn and Ermon, 2019,
      "Meta-Inverse Reinforcement Learning with Probabilistic Context Variables", arXiv:1909.09314);
    - ``loss_info_reward``: its gradient reaches theta (and phi) alone and is an unbiased estimate
      of minus Lemma 2, Cov(log q, grad R_theta) within each context; see
      :func:`pemirl_trl.functional.info_reward_loss`.

    Metric (detached): ``log_q``, the mean of log q_psi(m|tau) in nats, as it enters the losses.

    Args:
        encoder: q_psi; needs ``get_dist``.
        reward: r and f.
        rollouts_per_context: K >= 2; the batch holds the K rollouts of each context in a row, all
            of one length: no mask is read.
        summand: what R_theta sums over the rollout: ``"shaped"`` f, as the paper, of which the
            potentials telescope to the end states, or ``"state"`` r alone.
        time_mean: average over time instead of summing, which divides the estimate by T.
        normalize: divide log q by its deviation over the batch, which rescales the estimate.
        form: ``"covariance"``, Lemma 2's surrogate, or ``"tilted"``, which is bounded; see
            :func:`pemirl_trl.functional.tilted_info_reward_loss`.
        prior_fraction: share of the prior N(0, I) that q is mixed with, in both losses; see
            :func:`pemirl_trl.functional.mixed_with_prior`. An extension of the paper; 0 is off.

    Raises:
        TypeError: encoder or reward is none.
        ValueError: an unknown summand, or K < 2.

    Example:
        >>> import torch
        >>> from pemirl_trl import ContextEncoder
        >>> loss = InfoLoss(
        ...     ContextEncoder(6, 2, 3, horizon=10), ShapedReward(6, 3), rollouts_per_context=2
        ... )
        >>> rollouts = TensorDict(
        ...     {
        ...         "observation": torch.randn(4, 10, 6),
        ...         "action": torch.randn(4, 10, 2),
        ...         "next": {"observation": torch.randn(4, 10, 6)},
        ...         "context": torch.randn(2, 1, 3).repeat_interleave(2, 0).expand(4, 10, 3),
        ...     },
        ...     [4, 10],
        ... )
        >>> sorted(loss(rollouts).keys())
        ['log_q', 'loss_info_encoder', 'loss_info_reward']
    """

    @dataclass
    class _AcceptedKeys:
        observation: NestedKey = "observation"
        action: NestedKey = "action"
        next_observation: NestedKey = ("next", "observation")
        context: NestedKey = "context"

    default_keys = _AcceptedKeys
    tensor_keys: _AcceptedKeys
    out_keys = ["loss_info_encoder", "loss_info_reward", "log_q"]  # noqa: RUF012 (TorchRL's)

    encoder_network: ProbabilisticTensorDictSequential
    encoder_network_params: TensorDictParams
    target_encoder_network_params: TensorDictParams
    reward_network: ShapedReward
    reward_network_params: TensorDictParams
    target_reward_network_params: TensorDictParams

    def __init__(
        self,
        encoder: ProbabilisticTensorDictSequential,
        reward: ShapedReward,
        *,
        rollouts_per_context: int,
        summand: Summand = "shaped",
        time_mean: bool = False,
        normalize: bool = False,
        form: Form = "covariance",
        prior_fraction: float = 0.0,
    ) -> None:
        if form not in get_args(Form):
            raise ValueError(f"unknown form {form!r}; choose one of {get_args(Form)}")
        if form == "tilted" and normalize:
            raise ValueError("normalize rescales the covariance; the tilted form needs none")
        if summand not in get_args(Summand):
            raise ValueError(f"unknown summand {summand!r}; choose one of {get_args(Summand)}")
        if rollouts_per_context < 2:
            raise ValueError(
                f"a covariance needs at least 2 rollouts per context, got {rollouts_per_context}"
            )
        ENCODER.required(encoder, "InfoLoss")
        REWARD.required(reward, "InfoLoss")
        super().__init__()
        self.convert_to_functional(encoder, "encoder_network", create_target_params=False)
        self.convert_to_functional(reward, "reward_network", create_target_params=False)
        self.rollouts_per_context = rollouts_per_context
        self.summand = summand
        self.time_mean = time_mean
        self.normalize = normalize
        self.form = form
        self.prior_fraction = prior_fraction
        self.set_keys(context=reward.context_key)

    def _input_keys(self) -> list[NestedKey]:
        k = self.tensor_keys
        return [k.observation, k.action, k.next_observation, k.context]

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDict:
        """Compute both losses.

        Args:
            tensordict: rollouts ``[N, T]`` or ``[N]`` with leaves ``[N, T, ...]``, N = M K,
                context-major; ``context`` is ``[N, T, D]``, constant along T.

        Raises:
            MissingKeyError: the batch lacks one of ``in_keys``.
            ValueError: it has no dimension of time, or its rows are not K rollouts per context.
        """
        observation, action, next_observation, context = (
            self._read(tensordict, role)
            for role in ("observation", "action", "next_observation", "context")
        )
        require_time(observation, "InfoLoss", "observation")
        m = self._grouped(context.detach())  # [M, K, D]
        log_q = self._log_q(observation, action, m.flatten(0, 1)).view(m.shape[:2])
        returns = self._returns(observation, next_observation, context.detach()).view(m.shape[:2])
        if self.form == "tilted":
            loss_reward = tilted_info_reward_loss(log_q, returns)
        else:
            loss_reward = info_reward_loss(log_q, returns, normalize=self.normalize)
        return TensorDict(
            {
                "loss_info_encoder": info_encoder_loss(log_q),
                "loss_info_reward": loss_reward,
                "log_q": log_q.detach().mean(),
            }
        )

    def _grouped(self, context: Tensor) -> Tensor:
        """One m for each rollout, ``[M, K, D]``; raise unless the K of a context share it."""
        rollouts, k = context.shape[0], self.rollouts_per_context
        groups, rest = divmod(rollouts, k)
        if rest:
            raise ValueError(
                f"got {rollouts} rollouts, which {k} rollouts per context do not divide"
            )
        m = per_rollout(context, time_dim=1).view(groups, k, -1)
        if not torch.equal(m, m[:, :1].expand_as(m)):
            raise ValueError(
                f"the {k} rollouts of a context must stand in a row and share it; got groups with "
                "different contexts"
            )
        return m

    def _log_q(self, observation: Tensor, action: Tensor, m: Tensor) -> Tensor:
        """Log of q_psi(m|tau), mixed with the prior where that is asked for: ``[N]``."""
        inputs = TensorDict({"observation": observation, "action": action}, [len(m)])
        with self.encoder_network_params.to_module(
            self.encoder_network, preserve_module_state=False
        ):
            log_q = self.encoder_network.get_dist(inputs).log_prob(m)
        return mixed_with_prior(log_q, _log_prior(m), self.prior_fraction)

    def _returns(self, observation: Tensor, next_observation: Tensor, context: Tensor) -> Tensor:
        """R_theta(tau, m), of f or of r, the sum or the mean over time of each rollout: ``[N]``."""
        network = self.reward_network
        inputs = TensorDict(
            {
                network.observation_key: observation,
                network.next_observation_key: next_observation,
                network.context_key: context,
            },
            observation.shape[:2],
        )
        with self.reward_network_params.to_module(network, preserve_module_state=False):
            outputs = network(inputs)
        shaped = self.summand == "shaped"
        per_step = outputs[network.shaped_reward_key if shaped else network.reward_key].squeeze(-1)
        return per_step.mean(-1) if self.time_mean else per_step.sum(-1)


def _log_prior(m: Tensor) -> Tensor:
    """Log N(m; 0, I) of contexts ``[N, D]``, in nats: ``[N]``."""
    return Normal(0.0, 1.0).log_prob(m).sum(-1)
