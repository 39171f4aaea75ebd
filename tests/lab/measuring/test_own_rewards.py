"""The report on a reward of one's own measures what its episodes are long enough for."""

from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict

from pemirl_lab.measuring.own_rewards import measure_own_reward


def coverage(steps):
    """Two tasks' transitions of four numbers."""
    torch.manual_seed(0)
    states = torch.randn(2, steps + 1, 4)
    goals = torch.zeros(2, steps, 2)
    values = {
        "observation": states[:, :-1],
        "next": {"observation": states[:, 1:]},
        "action": torch.zeros(2, steps, 1),
        "task": {"parameters": goals},
    }
    return {"demonstrated": TensorDict(values, [2, steps])}


def measured(steps):
    report = SimpleNamespace(features=64, epic_transitions=32, epic_samples=16)
    rewards = {"r": lambda batch: -batch["observation"][..., :2].norm(dim=-1)}
    candidate = SimpleNamespace(rewards=rewards, gamma=0.99)
    true = lambda states, goal: -(states[..., :2] - goal).norm(dim=-1)  # noqa: E731
    return measure_own_reward(report, candidate, true, coverage(steps), 0)


def test_radial_functions_leave_room_for_the_components_of_an_observation():
    _, features = measured(60)
    assert features == 10


def test_episodes_that_are_too_short_are_refused():
    with pytest.raises(ValueError, match="got 12 transitions per task for 5 features"):
        measured(12)
