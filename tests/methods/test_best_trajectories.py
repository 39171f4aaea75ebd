"""Trajectories are scored under every task, and the best ones are kept and imitated."""

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

from pemirl_trl import ContextPolicy, PEMIRLModel
from pemirl_trl.methods import BestTrajectories
from pemirl_trl.methods.best_trajectories import cross_returns

NEAR = TensorDictModule(
    lambda s, m: -(s - m).abs(),
    in_keys=["observation", "context"],
    out_keys=["learned_reward"],
)
"""r(s, m) = -|s - m|."""


def rollouts(places, contexts, horizon=8):
    """One rollout per place, standing there; K per context; the action tells the place."""
    shape = [len(places), horizon]
    repeats = len(places) // len(contexts)
    place = torch.tensor(places).view(-1, 1, 1).expand(*shape, 1)
    m = torch.tensor(contexts).repeat_interleave(repeats).view(-1, 1, 1).expand(*shape, 1)
    return TensorDict({"observation": place, "action": 10.0 * place, "context": m}, shape)


def test_cross_returns_equal_a_loop_over_contexts():
    torch.manual_seed(0)
    model = PEMIRLModel(3, 2, 5)
    data = TensorDict(
        {"observation": torch.randn(7, 5, 3), "context": torch.randn(7, 5, 3)}, [7, 5]
    )
    context = torch.randn(6, 3)
    expected = torch.stack(
        [model.reward.reward(data["observation"], m.expand(7, 5, 3)).sum((1, 2)) for m in context]
    )
    tasks = TensorDict({"context": context}, [6])
    assert torch.allclose(cross_returns(model.reward, data, tasks), expected, atol=1e-5)


def test_a_task_may_be_made_of_several_keys():
    """An oracle's reward reads the goal, its policy a context: both belong to the task."""
    towards_goal = TensorDictModule(
        lambda s, g: -(s - g).abs(),
        in_keys=["observation", ("task", "goal")],
        out_keys=["learned_reward"],
    )
    data = rollouts([0.5, 0.9, 0.4, 0.2], [7.0, 8.0])
    goals = torch.tensor([0.0, 0.0, 1.0, 1.0]).view(4, 1, 1).expand(4, 8, 1)
    data.set(("task", "goal"), goals)
    best = BestTrajectories(towards_goal, 2, task_keys=("context", ("task", "goal")))
    best.update(data)
    kept = best.state_dict()
    assert kept["observation"][:, 0, 0].tolist() == pytest.approx([0.2, 0.9])
    assert kept["context"][:, 0].tolist() == [7.0, 8.0]
    assert kept["task.goal"][:, 0].tolist() == [0.0, 1.0]
    resumed = BestTrajectories(towards_goal, 2, task_keys=("context", ("task", "goal")))
    resumed.load_state_dict(kept)
    assert resumed.update(data)["best/from_other_tasks"] == 0.0


def test_a_task_takes_the_best_trajectory_whoever_found_it():
    best = BestTrajectories(NEAR, rollouts_per_context=2)
    # Task 0 is at 0 and task 1 at 1. The rollout that stands at 0.9 was collected for task 0.
    metrics = best.update(rollouts([0.5, 0.9, 0.4, 0.2], [0.0, 1.0]))
    kept = best.state_dict()
    assert kept["observation"][:, 0, 0].tolist() == pytest.approx([0.2, 0.9])
    assert kept["action"][:, 0, 0].tolist() == pytest.approx([2.0, 9.0])
    assert kept["context"][:, 0].tolist() == [0.0, 1.0]
    assert metrics["best/return"] == pytest.approx(-8 * (0.2 + 0.1) / 2)
    assert metrics["best/from_other_tasks"] == 1.0


def test_worse_trajectories_replace_nothing_and_a_checkpoint_restores_all():
    best = BestTrajectories(NEAR, rollouts_per_context=2)
    best.update(rollouts([0.5, 0.9, 0.4, 0.2], [0.0, 1.0]))
    resumed = BestTrajectories(NEAR, rollouts_per_context=2)
    resumed.load_state_dict({k: v.clone() for k, v in best.state_dict().items()})
    for one in (best, resumed):
        metrics = one.update(rollouts([0.05, 0.5, 0.5, 0.5], [0.0, 1.0]))
        assert one.state_dict()["observation"][:, 0, 0].tolist() == pytest.approx([0.05, 0.9])
        assert metrics["best/from_other_tasks"] == 0.0  # task 0 improved, by its own rollout


def test_actions_are_kept_within_their_bounds():
    best = BestTrajectories(NEAR, 1, (torch.tensor([-1.0]), torch.tensor([2.5])))
    best.update(rollouts([0.3, -0.5, 0.1], [0.3, -0.5, 0.1]))
    assert best.state_dict()["action"][:, 0, 0].tolist() == pytest.approx([2.5, -1.0, 1.0])


def test_the_loss_is_half_the_squared_error():
    best = BestTrajectories(NEAR, rollouts_per_context=1)
    policy = ContextPolicy(1, 1, 1, initial_scale=0.5)
    with pytest.raises(RuntimeError, match="call update first"):
        best.loss(policy, 1.0)
    best.update(rollouts([0.3], [0.0]))
    for parameter in policy.gaussian.net.parameters():
        parameter.data.zero_()
    # mean 0, action 3, whatever the deviation
    assert float(best.loss(policy, 2.0)().detach()) == pytest.approx(9.0)
