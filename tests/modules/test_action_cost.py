"""What an action costs beside r(s, m)."""

import pytest
import torch
from tensordict import TensorDict

from pemirl_trl import ShapedReward
from pemirl_trl.modules import ActionCost

BOUNDS = (torch.tensor([-1.0, -2.0]), torch.tensor([1.0, 3.0]))


@pytest.fixture
def reward():
    return ShapedReward(observation_dim=4, context_dim=3)


def batch(action, **more):
    n = len(action)
    states = {"observation": torch.randn(n, 4), "context": torch.randn(n, 3)}
    return TensorDict({**states, "action": torch.tensor(action), **more}, [n])


def test_it_is_the_reward_less_the_squared_action_that_is_done(reward):
    steps = batch([[0.5, 1.0], [-4.0, 5.0], [0.0, -9.0]])
    free = reward(steps.copy())["learned_reward"]
    costly = ActionCost(reward, 0.3, BOUNDS)(steps.copy())["learned_reward"]
    spent = torch.tensor([[0.25 + 1.0], [1.0 + 9.0], [0.0 + 4.0]])
    torch.testing.assert_close(costly, free - 0.3 * spent)


def test_nothing_is_charged_after_an_end(reward):
    steps = batch([[1.0, 1.0], [1.0, 1.0]], absorbing=torch.tensor([False, True]))
    free = reward(steps.copy())["learned_reward"]
    costly = ActionCost(reward, 1.0, BOUNDS)(steps.copy())["learned_reward"]
    torch.testing.assert_close(free - costly, torch.tensor([[2.0], [0.0]]))


def test_a_negative_cost_is_refused(reward):
    with pytest.raises(ValueError, match=r"cost is -1\.0; expected 0 or more"):
        ActionCost(reward, -1.0, BOUNDS)
