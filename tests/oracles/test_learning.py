"""The policy optimiser on a task whose optimal policy is known."""

import torch
from tensordict import TensorDict
from torchrl.envs import TransformedEnv

from pemirl_trl.methods import TRPOConfig
from pemirl_trl.methods.policy_optimization import PolicyOptimization, PolicyOptimizationConfig
from pemirl_trl.modules import ContextPolicy
from pemirl_trl.transforms import SampleTasks

from ..transforms.toy import Line

TASKS, ROLLOUTS, HORIZON = 16, 8, 3


def random_goals(count):
    return TensorDict({"goal": torch.randn(count, 1)}, [count])


def test_it_finds_the_optimal_linear_controller():
    """s' = s + a and reward -(s' - g)^2: the best action is g - s at every step, return 0."""
    env = TransformedEnv(
        Line(TASKS * ROLLOUTS, HORIZON), SampleTasks(random_goals, rollouts_per_task=ROLLOUTS)
    )
    policy = ContextPolicy(2, 1, 1, hidden=(), context_key=("task", "goal"))
    with torch.no_grad():
        policy.gaussian.net[0].weight.zero_()
        policy.gaussian.net[0].bias.zero_()
    training = PolicyOptimization(
        env,
        policy,
        HORIZON,
        PolicyOptimizationConfig(iterations=60, trpo=TRPOConfig(max_kl=0.05, fisher_rows=10_000)),
        rollouts_per_context=ROLLOUTS,
    )
    metrics = [training.iteration() for _ in range(training.iterations)]
    assert metrics[0]["return/true"] < -5.0
    assert metrics[-1]["return/true"] > -0.5
    assert sum(m["trpo/accepted"] for m in metrics) > 50
    position, time, goal = policy.gaussian.net[0].weight[0].tolist()
    assert abs(position + 1) < 0.1
    assert abs(goal - 1) < 0.1
    assert abs(time) < 0.1
    assert policy(env.reset())["scale"].max() < 0.3
