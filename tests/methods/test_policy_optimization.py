"""A policy from scratch, on the environment's reward or on a given one."""

import math

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.envs import TransformedEnv

from pemirl_trl import ContextPolicy, SampleTasks
from pemirl_trl.methods import PolicyOptimization, PolicyOptimizationConfig, TRPOConfig


def optimization(problem, reward=None, **config):
    """A policy that reads the goal, on 16 goals with 8 rollouts each."""
    policy = ContextPolicy(1, 1, 1, context_key=("task", "goal"), initial_scale=0.5)

    def tasks(count):
        return TensorDict({"goal": 2.0 * torch.rand(count, 1) - 1.0}, [count])

    env = TransformedEnv(problem.make(128), SampleTasks(tasks, rollouts_per_task=8))
    config = PolicyOptimizationConfig(
        iterations=25, trpo=TRPOConfig(gamma=1.0, max_kl=0.05), **config
    )
    return PolicyOptimization(
        env, policy, problem.horizon, config, rollouts_per_context=8, reward=reward
    )


def test_an_expert_learns_the_true_reward(reach):
    method = optimization(reach, final_scale=0.1)
    returns = [method.iteration()["return/true"] for _ in range(method.iterations)]
    # Straight to the goal, the distance |g| shrinks by 0.25 m a step: a return of -1.2 on average.
    assert returns[0] < -4.0
    assert returns[-1] > -2.0
    assert method.env_steps == 25 * 128 * 10


def test_a_given_reward_takes_the_place_of_the_environments(reach):
    to_the_right = TensorDictModule(
        lambda s: -(s - 0.8).abs(), in_keys=["observation"], out_keys=["learned_reward"]
    )
    method = optimization(reach, to_the_right, final_scale=0.1)
    metrics = [method.iteration() for _ in range(method.iterations)]
    assert metrics[-1]["return/learned"] > metrics[0]["return/learned"] + 2.0
    # The true one is measured all the same, and no better than standing at 0.8 m.
    assert metrics[-1]["return/true"] < -5.0


def test_a_forced_deviation_follows_its_schedule(reach):
    method = reach.policy_optimization(iterations=10, final_scale=0.1, anneal_finish=0.5)
    mean = [p.clone() for p in method.policy.gaussian.net.parameters()]
    scales = [method.iteration()["policy/scale"] for _ in range(10)]
    # The first of the ten iterations stands at 0, the last at 1.
    expected = [math.exp(min(1.0, i / 4.5) * math.log(0.1)) for i in range(10)]
    assert scales == pytest.approx(expected)
    assert any(
        not torch.equal(a, b)
        for a, b in zip(mean, method.policy.gaussian.net.parameters(), strict=True)
    )


def test_a_free_deviation_is_learned(reach):
    method = reach.policy_optimization(iterations=2)
    first, second = method.iteration(), method.iteration()
    assert first["policy/scale"] != second["policy/scale"]
    assert second["policy/learned_scale"] == second["policy/scale"]
    forced = reach.policy_optimization(iterations=2, final_scale=0.1)
    assert "policy/learned_scale" not in forced.iteration()


def test_imitating_the_best_needs_a_learned_reward(reach):
    with pytest.raises(ValueError, match="needs a reward that scores any task"):
        reach.policy_optimization(iterations=2, imitate_best=1.0)


def test_the_best_trajectories_are_kept_imitated_and_checkpointed(reach):
    method = reach.policy_optimization(
        learned=True, iterations=10, final_scale=0.1, imitate_best=3.0
    )
    metrics = [method.iteration() for _ in range(method.iterations)]
    best = [m["best/return"] for m in metrics]
    assert best == sorted(best)
    assert best[-1] > best[0]
    kept = method.components()["best"].state_dict()
    context = kept["context"].unsqueeze(1).expand(*kept["action"].shape[:2], -1)
    batch = TensorDict({"observation": kept["observation"], "context": context}, context.shape[:2])
    error = method.policy.get_dist(batch).mean - kept["action"]
    plain = reach.policy_optimization(learned=True, iterations=10, final_scale=0.1)
    for _ in range(plain.iterations):
        plain.iteration()
    other = plain.policy.get_dist(batch).mean - kept["action"]
    assert float(error.square().mean().detach()) < 0.8 * float(other.square().mean().detach())
    assert "best" not in plain.components()
