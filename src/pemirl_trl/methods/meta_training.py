"""Whole methods by name: networks, Meta-IL, the adversarial training, and how they start.

>>> from pemirl_trl.methods import METHODS
>>> sorted(METHODS)
['airl', 'meta_il', 'meta_infogail', 'pemirl', 'pemirl_contrastive', 'pemirl_literal', \
'pemirl_no_info', 'pemirl_rescaled', 'pemirl_robust']
>>> METHODS["pemirl_robust"].training.gradient_penalty_coeff
0.1

The recipes' ``method=NAME`` is the entry of that name here; a new method is one entry.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from typing import Any, Literal

from pydantic.dataclasses import dataclass
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from pemirl_trl.configuration import CHECKED, Count, Decay
from pemirl_trl.data import DemonstrationDataset
from pemirl_trl.methods.adversarial import AdversarialConfig, PolicyConfig
from pemirl_trl.methods.airl import AIRL, AIRLConfig
from pemirl_trl.methods.averaging import AveragedReward
from pemirl_trl.methods.loop import Method
from pemirl_trl.methods.meta_il import MetaILConfig
from pemirl_trl.methods.meta_infogail import MetaInfoGAIL, MetaInfoGAILConfig
from pemirl_trl.methods.pemirl import PEMIRL, PEMIRLConfig
from pemirl_trl.methods.requirements import check_acted
from pemirl_trl.modules import ModelConfig, PEMIRLModel, Standardize

Algorithm = Literal["pemirl", "airl", "meta_infogail", "meta_il"]
Start = Literal["meta_il", "fresh"]
TRAINING: Mapping[str, type[AdversarialConfig]] = {
    "pemirl": PEMIRLConfig,
    "airl": AIRLConfig,
    "meta_infogail": MetaInfoGAILConfig,
    "meta_il": AdversarialConfig,  # it has none: what a task says of it is not read
}
"""The configuration of the adversarial training, by algorithm."""


@dataclass(frozen=True, config=CHECKED)
class MethodConfig:
    """What tells one way of meta-training from another; the defaults are the paper's PEMIRL.

    Attributes:
        algorithm: which of the library's methods trains the model. ``"meta_il"`` trains none:
            the model is Meta-IL's.
        model: sizes of the networks.
        meta_il: of the imitation that comes first wherever there are contexts.
        training: of the adversarial training, of the class that ``algorithm`` has.
        contexts_per_batch: M, contexts per iteration (the paper's code: 50).
        initial_encoder: where q_psi starts (the paper: Meta-IL's).
        initial_policy: where pi_omega starts (the paper: fresh).
        learn_policy_scale: whether the policy's deviation is learned, or held (and annealed). The
            uniform share of a policy of discrete actions never is.
        reward_average_decay: of an average of r's weights, per iteration; None is off.
        reward_reads: what of an observation r reads: all of it (the paper), or the components that
            the task is about, where somebody names them.
    """

    algorithm: Algorithm = "pemirl"
    model: ModelConfig = field(default_factory=ModelConfig)
    meta_il: MetaILConfig = field(default_factory=MetaILConfig)
    training: AdversarialConfig = field(default_factory=PEMIRLConfig)
    contexts_per_batch: Count = 50
    initial_encoder: Start = "meta_il"
    initial_policy: Start = "fresh"
    learn_policy_scale: bool = True
    reward_average_decay: Decay | None = None
    reward_reads: Literal["observation", "task_space"] = "observation"

    def __post_init__(self) -> None:
        expected = TRAINING[self.algorithm]
        if type(self.training) is not expected:
            raise ValueError(
                f"algorithm {self.algorithm!r} takes a training of {expected.__name__}, got "
                f"{type(self.training).__name__}"
            )
        self.model.check_scale("final_scale", self.training.policy.final_scale)
        if self.learn_policy_scale and self.model.actions == "discrete":
            raise ValueError("learn_policy_scale is true; a policy of discrete actions learns none")
        if self.model.context_dim == 0:
            for name in ("initial_encoder", "initial_policy"):
                if getattr(self, name) == "meta_il":
                    raise ValueError(f"{name}=meta_il needs contexts; got context_dim=0")
            if self.algorithm == "meta_il":
                raise ValueError("algorithm=meta_il needs contexts; got context_dim=0")


METHODS: Mapping[str, MethodConfig] = {
    "pemirl": MethodConfig(),
    "pemirl_literal": MethodConfig(training=PEMIRLConfig.literal()),
    "pemirl_rescaled": MethodConfig(training=PEMIRLConfig.rescaled(), learn_policy_scale=False),
    "pemirl_robust": MethodConfig(
        training=PEMIRLConfig.robust(), learn_policy_scale=False, reward_average_decay=0.9
    ),
    "pemirl_contrastive": MethodConfig(
        training=PEMIRLConfig.contrastive(), learn_policy_scale=False, reward_reads="task_space"
    ),
    # Adversarial IRL on the contexts of Meta-IL's encoder, which stays as it is.
    "pemirl_no_info": MethodConfig(algorithm="airl", training=AIRLConfig()),
    "airl": MethodConfig(
        algorithm="airl",
        model=ModelConfig(context_dim=0),
        training=AIRLConfig(policy=PolicyConfig(imitation_coeff=0.0)),
        initial_encoder="fresh",
    ),
    "meta_infogail": MethodConfig(
        algorithm="meta_infogail",
        model=ModelConfig(reward="gail"),
        training=MetaInfoGAILConfig(),
        initial_policy="meta_il",
    ),
    "meta_il": MethodConfig(
        algorithm="meta_il", training=AdversarialConfig(), learn_policy_scale=False
    ),
}
"""The paper's method, in three forms; two extensions; the baselines."""


def new_model(
    demonstrations: DemonstrationDataset,
    config: MethodConfig,
    *,
    task_space: Sequence[int] | None = None,
    **sizes: Any,
) -> PEMIRLModel:
    """An untrained model for demonstrations, with observations scaled by their statistics.

    Args:
        demonstrations: give S, A, T and the map of observations.
        config: of the method.
        task_space: which components of an observation the task is about, for
            ``reward_reads="task_space"``.
        sizes: fields of :class:`ModelConfig` to replace.

    Raises:
        ValueError: r is to read the task space, and nobody said what that is; the model is to know
            absorbing states, and the demonstrations have none; or they have no actions.
    """
    check_acted(demonstrations)
    if config.reward_reads == "task_space" and config.model.reward == "shaped":
        if task_space is None:
            raise ValueError(
                "this method's reward reads the task space: say which components of an "
                "observation the task is about (task_space), or choose reward_reads='observation'"
            )
        sizes = {"reward_features": list(task_space), **sizes}
    if config.model.absorbing and not demonstrations.absorbing:
        raise ValueError(
            "a model of absorbing states (model.absorbing) needs demonstrations with such, "
            "demonstrations.with_absorbing_states(); meta_train on an environment of one's own "
            "does that"
        )
    return PEMIRLModel(
        demonstrations.observation_dim,
        demonstrations.action_dim,
        demonstrations.horizon,
        dataclasses.replace(config.model, absorbing=demonstrations.absorbing, **sizes),
        _map_of_observations(demonstrations.trajectories()),
    )


def _map_of_observations(trajectories: TensorDictBase) -> Standardize:
    observation, mask = trajectories["observation"], trajectories.get("mask", None)
    return Standardize.fit(observation if mask is None else observation[mask])


def start_from(model: PEMIRLModel, meta_il: PEMIRLModel | None, config: MethodConfig) -> None:
    """Give a new model's encoder and policy the weights that the method starts from.

    Raises:
        ValueError: the method starts from Meta-IL's model, and there is none.
    """
    for name in ("encoder", "policy"):
        if getattr(config, f"initial_{name}") == "meta_il":
            if meta_il is None:
                raise ValueError(f"initial_{name}=meta_il needs Meta-IL's model; got none")
            model.get_submodule(name).load_state_dict(meta_il.get_submodule(name).state_dict())
    model.policy.log_scale.requires_grad_(config.learn_policy_scale)


def build(
    config: MethodConfig,
    model: PEMIRLModel,
    env: EnvBase,
    demonstrations: TensorDictBase,
    *,
    info_loss: Callable[[TensorDictBase], TensorDictBase] | None = None,
) -> Method:
    """The adversarial method that ``config`` describes, ready to be trained.

    Args:
        config: of the method.
        model: see :func:`new_model` and :func:`start_from`; trained in place.
        env: batch size ``[M K]``, with :class:`pemirl_trl.InferContext` over ``demonstrations``.
        demonstrations: batch size ``[J]``, leaves ``[J, T, ...]``; unlabelled.
        info_loss: another estimator of PEMIRL's information term, for comparisons.

    Raises:
        ValueError: Meta-IL, which needs no environment; or an ``info_loss`` for another algorithm.
    """
    if info_loss is not None and config.algorithm != "pemirl":
        raise ValueError(f"{config.algorithm} has no information term to replace")
    match config.training:
        case PEMIRLConfig() as training:
            method: Method = PEMIRL(model, env, demonstrations, training, info_loss=info_loss)
        case AIRLConfig() as training:
            method = AIRL(model, env, demonstrations, training)
        case MetaInfoGAILConfig() as training:
            method = MetaInfoGAIL(model, env, demonstrations, training)
        case _:
            raise ValueError("Meta-IL trains no reward: use pemirl_trl.methods.MetaIL")
    if config.reward_average_decay is None:
        return method
    return AveragedReward(method, model, config.reward_average_decay)
