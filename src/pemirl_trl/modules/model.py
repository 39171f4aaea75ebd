"""The networks of one PEMIRL model, and the numbers that rebuild them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

from pydantic.dataclasses import dataclass
from torch import nn

from pemirl_trl.configuration import CHECKED, Count, Index, Positive, Share
from pemirl_trl.modules.actors import ContextPolicy
from pemirl_trl.modules.attention_encoder import AttentionContextEncoder
from pemirl_trl.modules.categorical import CategoricalPolicy, check_share
from pemirl_trl.modules.context_encoder import ContextEncoder, MaskedContextEncoder, NoContext
from pemirl_trl.modules.discriminator import GAILDiscriminator
from pemirl_trl.modules.family import TrainingFamily
from pemirl_trl.modules.reward import ShapedReward
from pemirl_trl.modules.standardize import Standardize

EncoderKind = Literal["flat", "masked", "attention"]
EncoderReads = Literal["states_and_actions", "states"]
RewardKind = Literal["shaped", "gail"]
ActionKind = Literal["continuous", "discrete"]
Policy = ContextPolicy | CategoricalPolicy
ACTIVATIONS: dict[str, type[nn.Module]] = {"relu": nn.ReLU, "tanh": nn.Tanh}


@dataclass(frozen=True, config=CHECKED)
class ModelConfig:
    """Sizes of the networks, those of Yu et al. (2019, arXiv:1909.09314), Appendix E.1, with ReLU.

    Attributes:
        context_dim: D, dimension of the latent context; 0 for methods that know none.
        encoder: ``"flat"``, an MLP on the whole trajectory (the paper's), or, for trajectories of
            any length, ``"attention"``, or ``"masked"``, the average of embedded steps.
        encoder_reads: ``"states_and_actions"`` (the paper's), or ``"states"``: then m is inferred
            also of demonstrations without actions. Training needs them either way, for the policy.
        reward: ``"shaped"``, AIRL's r and h, or ``"gail"``, the logit of GAIL's D(s, a).
        encoder_hidden, policy_hidden, reward_hidden: widths of the hidden layers.
        reward_gamma: discount of the potential in f.
        policy_scale: the policy's deviation before training; of discrete actions, the share that is
            drawn uniformly, below 1.
        reward_features: which components of an observation r reads; None: all (the paper). See
            :class:`ShapedReward`; GAIL's D has no such choice.
        absorbing: whether the last component of an observation says that the episode has ended;
            see :class:`pemirl_trl.AbsorbingState`.
        actions: ``"continuous"``, of a Gaussian policy (the paper's), or ``"discrete"``, one-hot
            vectors of a categorical one.
    """

    context_dim: Index = 3
    encoder: EncoderKind = "flat"
    encoder_reads: EncoderReads = "states_and_actions"
    reward: RewardKind = "shaped"
    encoder_hidden: Sequence[Count] = (128, 128)
    policy_hidden: Sequence[Count] = (64, 64)
    reward_hidden: Sequence[Count] = (32, 32)
    reward_gamma: Share = 0.99
    policy_scale: Positive = 1.0
    reward_features: Sequence[Index] | None = None
    absorbing: bool = False
    actions: ActionKind = "continuous"

    def __post_init__(self) -> None:
        self.check_scale("policy_scale", self.policy_scale)

    def check_scale(self, name: str, scale: float | None) -> None:
        """Raise ValueError unless a policy of these actions can have the ``scale`` of that name."""
        if self.actions == "discrete" and scale is not None:
            check_share(name, scale)


class PEMIRLModel(nn.Module):
    """The networks of one domain: q_psi(m|tau), r_theta(s, m) with h_phi(s, m), pi_omega(a|s, m).

    Source: Yu, Yu, Finn and Ermon (2019), "Meta-Inverse Reinforcement Learning with Probabilistic
    Context Variables", arXiv:1909.09314.

    Attributes:
        encoder, reward, policy: the three networks; they share the map of observations.
            ``reward`` writes ``learned_reward``, whatever its kind.
        family: statistics of the demonstrations of its training, kept in its file; None where
            nobody knows them.

    Args:
        observation_dim, action_dim, horizon: S, A and T of the domain.
        config: sizes.
        standardize: the map of observations, commonly fitted on the demonstrations.

    Raises:
        ValueError: an unknown kind of encoder or of reward.

    Example:
        >>> model = PEMIRLModel(6, 2, 10, ModelConfig(context_dim=2))
        >>> model.policy.context_key, model.reward.reward_key
        ('context', 'learned_reward')
        >>> PEMIRLModel(6, 2, 10, ModelConfig(encoder="masked")).encoder.context_dim
        3
    """

    def __init__(
        self,
        observation_dim: int,
        action_dim: int,
        horizon: int,
        config: ModelConfig | None = None,
        standardize: Standardize | None = None,
    ) -> None:
        super().__init__()
        self.config = config = config or ModelConfig()
        self.observation_dim, self.action_dim, self.horizon = observation_dim, action_dim, horizon
        self.standardize = standardize or Standardize.identity(observation_dim)
        self.family: TrainingFamily | None = None
        self.encoder = self._new_encoder()
        self.reward = self._new_reward()
        self.policy = self.new_policy()

    def _new_encoder(
        self,
    ) -> ContextEncoder | MaskedContextEncoder | AttentionContextEncoder | NoContext:
        c = self.config
        if c.context_dim == 0:
            return NoContext()
        sizes = (self.observation_dim, self.action_dim, c.context_dim)
        common: dict[str, Any] = {
            "hidden": c.encoder_hidden,
            "standardize": self.standardize,
            "reads_actions": c.encoder_reads == "states_and_actions",
        }
        if c.encoder != "flat":
            kind = MaskedContextEncoder if c.encoder == "masked" else AttentionContextEncoder
            return kind(*sizes, **common)
        return ContextEncoder(*sizes, self.horizon, **common)

    def _new_reward(self) -> ShapedReward | GAILDiscriminator:
        c = self.config
        if c.reward == "shaped":
            return ShapedReward(
                self.observation_dim,
                c.context_dim,
                gamma=c.reward_gamma,
                hidden=c.reward_hidden,
                standardize=self.standardize,
                reward_features=c.reward_features,
            )
        return GAILDiscriminator(
            self.observation_dim,
            self.action_dim,
            hidden=c.reward_hidden,
            standardize=self.standardize,
        )

    def new_policy(
        self, scale: float | None = None, *, learn_scale: bool = True, activation: str = "relu"
    ) -> Policy:
        """Return a freshly initialised policy of this model's sizes, as adaptation starts from.

        Args:
            scale: deviation before training; None takes the configured one.
            learn_scale: whether the deviation is learned; the share of uniform actions, which
                stands in its place where actions are discrete, never is.
            activation: of the hidden layers, ``"relu"`` (the paper's) or ``"tanh"``.

        Raises:
            ValueError: another activation.
        """
        if activation not in ACTIVATIONS:
            raise ValueError(f"unknown activation {activation!r}; choose one of {[*ACTIVATIONS]}")
        sizes = (self.observation_dim, self.action_dim, self.config.context_dim)
        common: dict[str, Any] = {
            "hidden": self.config.policy_hidden,
            "activation": ACTIVATIONS[activation],
            "standardize": self.standardize,
            "initial_scale": self.config.policy_scale if scale is None else scale,
        }
        if self.config.actions == "discrete":
            return CategoricalPolicy(*sizes, **common)
        return ContextPolicy(*sizes, **common, learn_scale=learn_scale)

    def trained_policy(self, scale: float | None = None, *, learn_scale: bool = True) -> Policy:
        """Return a copy of this model's policy, its mean with a deviation of its own, to train on.

        Args:
            scale, learn_scale: of the deviation, as in :meth:`new_policy`.
        """
        policy = self.new_policy(scale, learn_scale=learn_scale)
        policy.net.load_state_dict(self.policy.net.state_dict())
        return policy
