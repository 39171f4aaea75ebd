"""Gymnasium's HalfCheetah-v5 at a velocity that it is not told, and with a weak hind leg."""

from __future__ import annotations

import copy

import mujoco
import torch
from gymnasium_task import Expert, GymnasiumTask, uniform
from tensordict import TensorDict, TensorDictBase
from torch import Generator, Tensor, nn
from torchrl.envs import TransformedEnv

from pemirl_envs import Component, Fields, Parameters, State, TaskEnv
from pemirl_trl import ContextPolicy, SampleTasks
from pemirl_trl.methods import PolicyOptimization, PolicyOptimizationConfig, TRPOConfig, train

FASTEST = 2.0  # m/s, forward and backward
WEAKNESS = 0.2  # share of the strength that the changed body's hind thigh has left
CONTROL_COST = 0.1  # Gymnasium's
VELOCITY = 8  # the component of an observation
NOISE = 0.1  # of the demonstrated actions, which are bounded by 1
DEMONSTRATIONS = 400
SETTINGS = ("preset=contrastive", f"task_space=[{VELOCITY}]")  # a body moves what the task is about
# By name of the result; r(s, m) is in units of its own.
ADAPTATIONS = {"half_cheetah": {}, "half_cheetah_action_cost": {"action_cost": CONTROL_COST}}
TARGETS, ROLLOUTS = 20, 8  # of an iteration of the expert's training
EXPERT_ITERATIONS = 150  # and half as many under the change


class HalfCheetah(GymnasiumTask):
    """A torso is to move at ``velocity`` ``[N, 1]`` (m/s), forward or backward.

    Args:
        changed: the motor of the hind thigh is weak.
    """

    xml = "half_cheetah.xml"
    horizon = 100
    n_sub_steps = 5
    observation_components = (
        Component("height_and_pitch", "m, rad", 2),
        Component("joint_angles", "rad", 6),
        Component("forward_velocity", "m/s"),
        Component("vertical_velocity_and_pitch_rate", "m/s, rad/s", 2),
        Component("joint_velocities", "rad/s", 6),
    )
    task_space = ("forward_velocity",)

    def __init__(self, changed: bool = False) -> None:
        self.changed = changed
        bound = torch.tensor([FASTEST])
        self.parameter_bounds = {"velocity": (-bound, bound)}

    def build_spec(self) -> mujoco.MjSpec:
        """Gymnasium's body, or the changed one."""
        spec = super().build_spec()
        if self.changed:
            spec.actuator("bthigh").gear[0] *= WEAKNESS
        return spec

    def sample_parameters(self, n: int, split: str, generator: Generator) -> dict[str, Tensor]:
        """Velocities, uniform."""
        return {"velocity": uniform(n, 1, bound=FASTEST, generator=generator).float()}

    def initial_state(self, parameters: Parameters, generator: Generator) -> State:
        """Positions within 0.1 of the model's own, velocities normal with 0.1, as in Gymnasium."""
        n = len(parameters["velocity"])
        qpos = uniform(n, 9, bound=0.1, generator=generator)
        return {
            "qpos": qpos,
            "qvel": 0.1 * torch.randn(n, 9, dtype=qpos.dtype, generator=generator),
        }

    def observe(self, fields: Fields) -> Tensor:
        """All positions but that along the way, and all velocities: Gymnasium's observation."""
        return torch.cat([fields("qpos")[:, 1:], fields("qvel")], -1).float()

    @staticmethod
    def terms(observation: Tensor, action: Tensor, value: Tensor) -> dict[str, Tensor]:
        """Minus the error of the velocity, and Gymnasium's cost of actions, each ``[..., 1]``."""
        error = (observation[..., VELOCITY : VELOCITY + 1] - value).abs()
        cost = CONTROL_COST * action.square().sum(-1, keepdim=True)
        return {"velocity": -error, "actions": -cost}


def make_env(num_envs: int, seed: int) -> TaskEnv:
    """Gymnasium's body."""
    return TaskEnv(HalfCheetah(), num_envs, seed=seed)


def make_changed_env(num_envs: int, seed: int) -> TaskEnv:
    """The body with the weak thigh."""
    return TaskEnv(HalfCheetah(changed=True), num_envs, seed=seed)


def experts(seed: int) -> tuple[Expert, Expert]:
    """Policies that read the velocity: of Gymnasium's body, and trained on under the change."""
    torch.manual_seed(seed)
    policy = ContextPolicy(
        *(HalfCheetah.component_slice("joint_velocities").stop, 6, 1),
        activation=nn.Tanh,
        initial_scale=0.7,
        context_key=("task", "velocity"),
    )
    reinforce(policy, HalfCheetah(), EXPERT_ITERATIONS, seed)
    changed = copy.deepcopy(policy)
    reinforce(changed, HalfCheetah(changed=True), EXPERT_ITERATIONS // 2, seed)
    return policy, changed


def reinforce(policy: ContextPolicy, task: HalfCheetah, iterations: int, seed: int) -> None:
    """TRPO on the true reward, in place."""
    generator = torch.Generator().manual_seed(seed)

    def targets(count: int) -> TensorDictBase:
        return TensorDict(task.sample_parameters(count, "uniform", generator), [count])

    config = PolicyOptimizationConfig(
        iterations=iterations,
        trpo=TRPOConfig(gamma=0.99, lmbda=0.97, max_kl=0.06, standardize="context"),
        standardize_observations=True,
    )
    base = TaskEnv(task, TARGETS * ROLLOUTS, seed=seed)
    env = TransformedEnv(base, SampleTasks(targets, rollouts_per_task=ROLLOUTS))
    train(PolicyOptimization(env, policy, task.horizon, config, rollouts_per_context=ROLLOUTS))
