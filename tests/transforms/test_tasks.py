"""Environments in a row share a task, drawn anew at each reset."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import TransformedEnv
from torchrl.envs.utils import check_env_specs

from pemirl_trl.transforms import SampleTasks

from .toy import Line

M, K, T = 4, 3, 3


def random_goals(count):
    return TensorDict({"goal": torch.randn(count, 1)}, [count])


def environment(tasks=random_goals, num_envs=M * K):
    return TransformedEnv(Line(num_envs, T), SampleTasks(tasks, rollouts_per_task=K))


def test_specs_hold():
    check_env_specs(environment())


def test_groups_share_the_tasks_asked_for():
    asked = []

    def goals(count):
        asked.append(count)
        return TensorDict({"goal": torch.arange(float(count)).unsqueeze(-1)}, [count])

    batch = environment(goals).rollout(T)
    expected = torch.arange(float(M)).repeat_interleave(K).view(-1, 1, 1).expand(-1, T, -1)
    assert set(asked) == {M}
    assert torch.equal(batch["task", "goal"], expected)
    position = batch["next", "observation"][..., :1]
    assert torch.equal(batch["next", "reward"], -(position - expected).square())


def test_each_reset_draws_anew():
    batch = environment().rollout(2 * T, break_when_any_done=False)
    goal = batch["task", "goal"].view(M * K, 2, T)
    assert torch.equal(goal, goal[:, :, :1].expand_as(goal))
    assert (goal[:, 0, 0] != goal[:, 1, 0]).all()


def test_environments_that_do_not_divide_are_refused():
    with pytest.raises(ValueError, match="10 environments do not divide into 3 rollouts per task"):
        environment(num_envs=10).reset()
