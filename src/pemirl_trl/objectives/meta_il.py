"""Meta-imitation learning with latent contexts: a conditional VAE of demonstrations."""

from __future__ import annotations

from dataclasses import dataclass

from tensordict import TensorDict, TensorDictBase
from tensordict.nn import ProbabilisticTensorDictSequential, TensorDictParams, dispatch
from tensordict.utils import NestedKey

from pemirl_trl.functional import kl_to_standard_normal
from pemirl_trl.modules.reading import ENCODER, POLICY, acted_steps, key_of, shown_of
from pemirl_trl.objectives.common import KeyedLoss, require_time


class MetaILLoss(KeyedLoss):
    r"""The negative evidence bound of Meta-IL, for psi and omega together.

    ``loss_imitation`` = -mean_t log pi(a_t|s_t, m), m ~ q_psi(m|tau) by reparameterisation, and
    ``loss_kl`` = kl_coeff * KL(q_psi(m|tau) || N(0, I)), both in nats. Source: Section 4 of Yu, Yu,
    Finn and Ermon (2019), "Meta-Inverse Reinforcement Learning with Probabilistic Context
    Variables", arXiv:1909.09314; the coefficient 0.1 is that of the authors' code.

    Metrics (detached): ``kl`` in nats.

    Args:
        encoder: q_psi.
        policy: pi_omega; its ``observation_key`` and ``context_key``, where it has these, say where
            it reads s and m. By default ``observation`` and ``context``.
        kl_coeff: weight of the KL term, per trajectory, against the likelihood per step.

    Raises:
        TypeError: encoder or policy is none.
        ValueError: the policy reads no context; on a call, the batch has no time.
        MissingKeyError: on a call, the batch lacks a key.

    Example:
        >>> import torch
        >>> from pemirl_trl import ContextEncoder, ContextPolicy, DemonstrationDataset
        >>> demonstrations = DemonstrationDataset(torch.randn(8, 11, 6), torch.randn(8, 10, 2))
        >>> loss = MetaILLoss(ContextEncoder(6, 2, 3, horizon=10), ContextPolicy(6, 2, 3))
        >>> losses = loss(demonstrations)  # or its trajectories()
        >>> sorted(losses.keys())
        ['kl', 'loss_imitation', 'loss_kl']
    """

    @dataclass
    class _AcceptedKeys:
        observation: NestedKey = "observation"
        action: NestedKey = "action"

    default_keys = _AcceptedKeys
    tensor_keys: _AcceptedKeys
    out_keys = ["loss_imitation", "loss_kl", "kl"]  # noqa: RUF012 (TorchRL's convention)

    encoder_network: ProbabilisticTensorDictSequential
    encoder_network_params: TensorDictParams
    target_encoder_network_params: TensorDictParams
    actor_network: ProbabilisticTensorDictSequential
    actor_network_params: TensorDictParams
    target_actor_network_params: TensorDictParams

    def __init__(
        self,
        encoder: ProbabilisticTensorDictSequential,
        policy: ProbabilisticTensorDictSequential,
        *,
        kl_coeff: float = 0.1,
    ) -> None:
        ENCODER.required(encoder, "MetaILLoss")
        POLICY.required(policy, "MetaILLoss")
        super().__init__()
        self._policy_observation = key_of(policy, "observation")
        self._policy_context = key_of(policy, "context")
        self.convert_to_functional(encoder, "encoder_network", create_target_params=False)
        self.convert_to_functional(policy, "actor_network", create_target_params=False)
        self.kl_coeff = kl_coeff

    def _input_keys(self) -> list[NestedKey]:
        return [self.tensor_keys.observation, self.tensor_keys.action]

    @dispatch
    def forward(self, tensordict: TensorDictBase) -> TensorDict:
        """Compute both losses.

        Args:
            tensordict: demonstrations, leaves ``[N, T, ...]``, or a data set with a method
                ``trajectories``. Where they have a ``mask`` (False for padding) or ``absorbing``
                (True after an end), only actions that were somebody's choice are imitated.

        Raises:
            MissingKeyError: it lacks one of ``in_keys``.
            ValueError: its leaves have no dimension of time.
        """
        observation = self._read(tensordict, "observation")
        action = self._read(tensordict, "action")
        require_time(observation, "MetaILLoss", "observation")
        shown = shown_of(tensordict)
        inputs = TensorDict(
            {key: self._read(shown, key) for key in ("observation", "action")},
            observation.shape[:1],
        )
        if (mask := shown.get("mask", None)) is not None:
            inputs.set("mask", mask)
        with self.encoder_network_params.to_module(
            self.encoder_network, preserve_module_state=False
        ):
            posterior = self.encoder_network.get_dist(inputs)
        # The loss runs under deterministic exploration: the module itself would give the mean.
        m = posterior.rsample()
        steps = observation.shape[:2]
        context = m.unsqueeze(1).expand(*steps, m.shape[-1])
        inputs = TensorDict(
            {self._policy_observation: observation, self._policy_context: context}, steps
        )
        if (acted := acted_steps(tensordict)) is not None:
            inputs, action = inputs[acted], action[acted]
        with self.actor_network_params.to_module(self.actor_network, preserve_module_state=False):
            log_prob = self.actor_network.get_dist(inputs).log_prob(action)
        kl = kl_to_standard_normal(posterior.mean, posterior.stddev).mean()
        return TensorDict(
            {
                "loss_imitation": -log_prob.mean(),
                "loss_kl": self.kl_coeff * kl,
                "kl": kl.detach(),
            }
        )
