"""On rewards whose shape is known, the measures say what is known."""

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

from pemirl_trl.evaluation.reward_quality import (
    argmax_error,
    distance_to_goal,
    position_grid,
    reward_on_grid,
    spearman_with_distance,
)

BOUNDS = ((-0.1, 0.5), (0.0, 1.2))
GOALS = torch.tensor([[0.0, 0.9], [0.4, 0.3], [0.2, 0.6]])
GRID = position_grid(BOUNDS, (120, 60))  # cells of 1 cm


def reward_module(function, out="learned_reward"):
    return TensorDictModule(function, in_keys=["observation", "context"], out_keys=[out])


def towards_goal(observation, context):
    return -(observation - context).norm(dim=-1, keepdim=True)


def test_grid_holds_the_centres_of_cells():
    grid = position_grid(((0.0, 3.0), (10.0, 12.0)), (2, 3))
    assert grid.tolist() == [
        [[0.5, 10.5], [1.5, 10.5], [2.5, 10.5]],
        [[0.5, 11.5], [1.5, 11.5], [2.5, 11.5]],
    ]


def test_every_context_is_paired_with_every_position():
    reward = reward_on_grid(reward_module(towards_goal), GOALS, GRID)
    assert reward.shape == (3, 120, 60)
    for c, i, j in [(0, 0, 0), (1, 119, 3), (2, 40, 59)]:
        expected = towards_goal(GRID[i, j], GOALS[c])
        torch.testing.assert_close(reward[c, i, j], expected[0])


def test_a_goal_directed_reward_is_perfect_and_its_negative_is_not():
    reward = reward_on_grid(reward_module(towards_goal), GOALS, GRID)
    ones = torch.ones(3, dtype=torch.float64)
    torch.testing.assert_close(spearman_with_distance(reward, GRID, GOALS), ones)
    torch.testing.assert_close(spearman_with_distance(-reward, GRID, GOALS), -ones)
    scaled = (5 * reward.double() - 3).exp()  # the reward's scale is arbitrary, its order is not
    torch.testing.assert_close(spearman_with_distance(scaled, GRID, GOALS), ones)


def test_argmax_error_is_the_offset_in_metres():
    offset = torch.tensor([0.03, -0.04])  # 5 cm
    reward = reward_on_grid(reward_module(towards_goal), GOALS + offset, GRID)
    torch.testing.assert_close(
        argmax_error(reward, GRID, GOALS), torch.full((3,), 0.05), rtol=0, atol=0.0071
    )
    assert argmax_error(-distance_to_goal(GRID, GOALS), GRID, GOALS).max() < 0.0071


def test_observations_may_hold_more_than_the_position():
    def embed(positions):
        return torch.cat([torch.full_like(positions, 9.0), positions], dim=-1)

    def read_the_end(observation, context):
        assert (observation[..., :2] == 9).all()
        return towards_goal(observation[..., 2:], context)

    direct = reward_on_grid(reward_module(towards_goal), GOALS, GRID)
    embedded = reward_on_grid(reward_module(read_the_end), GOALS, GRID, observe=embed)
    assert torch.equal(direct, embedded)


def test_keys_are_arguments_and_no_gradient_flows():
    layer = torch.nn.Linear(4, 1)
    module = TensorDictModule(
        lambda o, m: layer(torch.cat([o, m], -1)), in_keys=["state", "m"], out_keys=[("r", "f")]
    )
    reward = reward_on_grid(
        module,
        GOALS,
        GRID,
        reward_key=("r", "f"),
        observation_key="state",
        context_key="m",
    )
    assert not reward.requires_grad
    flat = TensorDict({"state": GRID[5, 6][None], "m": GOALS[1:2]}, [1])
    torch.testing.assert_close(reward[1, 5, 6], module(flat)["r", "f"][0, 0])


def test_mistakes_are_explained():
    with pytest.raises(ValueError, match=r"wrote nothing under 'learned_reward'"):
        reward_on_grid(reward_module(towards_goal, out="f"), GOALS, GRID)
    with pytest.raises(ValueError, match=r"wrote shape \(21600, 2\)"):
        reward_on_grid(reward_module(lambda o, m: o - m), GOALS, GRID)
    with pytest.raises(ValueError, match=r"context \(2,\)"):
        reward_on_grid(reward_module(towards_goal), GOALS[0], GRID)
    with pytest.raises(ValueError, match="low < high"):
        position_grid(((1.0, 0.0), (0.0, 1.0)), (2, 2))
