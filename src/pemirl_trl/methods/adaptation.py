"""A policy trained on the learned reward of one demonstration per task (Algorithm 2)."""

from __future__ import annotations

from dataclasses import field
from typing import Literal

from pydantic.dataclasses import dataclass
from tensordict.nn import TensorDictModuleBase
from torchrl.envs import EnvBase

from pemirl_trl.configuration import CHECKED, Count, NonNegative, Positive
from pemirl_trl.methods.policy_optimization import PolicyOptimizationConfig
from pemirl_trl.modules import ActionCost, PEMIRLModel
from pemirl_trl.modules.model import Policy


@dataclass(frozen=True, config=CHECKED)
class AdaptationConfig:
    """Of Algorithm 2; the defaults are those of Point-Maze.

    Attributes:
        rollouts: episodes per iteration, shared evenly by the demonstrated tasks.
        initial_policy: ``"fresh"`` (the paper) or ``"trained"``: the one that meta-training ended
            with.
        policy_activation: of a fresh one.
        policy_scale: the deviation at the start; of discrete actions, the uniform share.
        learn_policy_scale: whether it is learned; ``optimization.final_scale`` forces it.
        action_cost: what a squared unit of an action costs, in r's units: knowledge of the user's
            that no r(s, m) can hold. See :class:`pemirl_trl.modules.ActionCost`. 0 is nothing.
        optimization: of the policy.
    """

    rollouts: Count = 180
    initial_policy: Literal["fresh", "trained"] = "fresh"
    policy_activation: Literal["relu", "tanh"] = "tanh"
    policy_scale: Positive = 3.0
    learn_policy_scale: bool = False
    action_cost: NonNegative = 0.0
    optimization: PolicyOptimizationConfig = field(
        default_factory=PolicyOptimizationConfig.adaptation
    )


def initial_policy(model: PEMIRLModel, config: AdaptationConfig) -> tuple[Policy, str]:
    """The policy that adaptation starts from, and the activation of its hidden layers.

    Raises:
        ValueError: a deviation that no policy of discrete actions can have, or that it would learn.
    """
    model.config.check_scale("policy_scale", config.policy_scale)
    model.config.check_scale("final_scale", config.optimization.final_scale)
    if config.learn_policy_scale and model.config.actions == "discrete":
        raise ValueError("learn_policy_scale is true; a policy of discrete actions learns none")
    scale, learned = config.policy_scale, config.learn_policy_scale
    if config.initial_policy == "trained":
        return model.trained_policy(scale, learn_scale=learned), "relu"
    activation = config.policy_activation
    return model.new_policy(scale, learn_scale=learned, activation=activation), activation


def objective(model: PEMIRLModel, config: AdaptationConfig, env: EnvBase) -> TensorDictModuleBase:
    """What adaptation maximises: r(s, m), less what the user says that actions cost.

    Raises:
        ValueError: a cost of actions that are choices.
    """
    if config.action_cost == 0:
        return model.reward
    if model.config.actions == "discrete":
        raise ValueError(
            f"action_cost is {config.action_cost:g}, and the actions are choices, which have no "
            "size; expected 0"
        )
    space = env.action_spec.space
    return ActionCost(model.reward, config.action_cost, (space.low[0], space.high[0]))
