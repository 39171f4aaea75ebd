"""On rewards that are known to equal the true one, or not to, the report says so."""

import json

import pytest
import torch
from tensordict import TensorDict

from pemirl_trl import ShapedReward
from pemirl_trl.evaluation.reward_quality import map_of_reward, position_grid
from pemirl_trl.evaluation.reward_report import (
    Measure,
    RewardReport,
    reward_report,
    shaped_reward_of,
    state_reward_of,
)

GAMMA = 0.95
GOALS = torch.tensor([[0.2, 0.9], [0.5, 0.8], [0.9, 0.7]])
GRID = position_grid(((0.0, 1.0), (0.0, 1.0)), (40, 40))  # cells of 2.5 cm


def coverage(B=300, tasks=3):
    """A point that steps at random in the unit square; its task is a goal."""
    s, action = torch.rand(tasks, B, 2), torch.randn(tasks, B, 2)
    task = {"goal": GOALS[:tasks, None].expand(tasks, B, 2)}
    following = {"observation": s + 0.05 * action}
    context = GOALS[:tasks, None].expand(tasks, B, 2)
    return TensorDict(
        {"observation": s, "action": action, "next": following, "task": task, "context": context},
        [tasks, B],
    )


def true(batch):
    return -(batch["observation"] - batch["task", "goal"]).norm(dim=-1)


def shaped(batch):
    """Scaled, shifted, and shaped by a potential that is linear in the state."""
    following, s = batch["next", "observation"].sum(-1), batch["observation"].sum(-1)
    return (5 * true(batch) + 3 + 40 * (GAMMA * following - s)).unsqueeze(-1)


def report(rewards, batch=None, **keywords):
    batch = coverage() if batch is None else batch
    grid = {"positions": GRID, "goals": GOALS}
    keywords = {"gamma": GAMMA, "features": 16, **grid} | keywords
    return reward_report(rewards, true, {"random": batch}, **keywords)


@pytest.mark.usefixtures("float64")
def test_the_true_reward_is_perfect_and_shaping_hides_it_from_correlation_alone():
    result = report({"r": true, "f": shaped}).per_task
    for name, metric, expected in (
        ("r", "spearman", 1),
        ("r", "pearson", 1),
        ("r", "epic", 0),
        ("r", "feasible", 0),
        ("f", "epic", 0),
        ("f", "feasible", 0),
    ):
        got = result[Measure(name, "random", metric)]
        torch.testing.assert_close(got, torch.full_like(got, expected), rtol=0, atol=1e-5)
    assert (result[Measure("f", "random", "spearman")].abs() < 0.5).all()
    assert (result[Measure("r", "map", "spearman")] > 0.999).all()
    assert (result[Measure("r", "map", "argmax_error")] < 0.018).all()  # half a cell's diagonal
    # At rest that shaping is -(1 - gamma) 40 (x + y) = -2 (x + y), against a slope of 5.
    assert (result[Measure("f", "map", "argmax_error")] < 0.018).all()


def test_stored_rewards_are_the_true_ones_of_what_happened():
    """Distances and correlations follow ``("next", "reward")``; EPIC must ask the function."""
    batch = coverage()
    batch["next", "reward"] = -true(batch).unsqueeze(-1)
    result = report({"r": true}, batch).per_task
    assert (result[Measure("r", "random", "spearman")] == -1).all()
    assert (result[Measure("r", "random", "feasible")] > 1 - 1e-5).all()
    assert (result[Measure("r", "random", "epic")] < 1e-5).all()


def test_a_constant_reward_counts_as_unrelated():
    result = report({"r": lambda batch: torch.full(batch.shape, 0.1)})
    expected = {"spearman": 0, "pearson": 0, "epic": 0.5**0.5, "feasible": 0.5**0.5}
    for metric, value in expected.items():
        assert result.summary()[f"r/random/{metric}/mean"] == pytest.approx(value)
    assert json.loads(json.dumps(result.summary(), allow_nan=False)) == result.summary()


def test_summary_and_table_take_the_worst_in_the_right_direction():
    values = torch.tensor([0.25, 0.5, 0.75])
    names = ("spearman", "feasible")
    result = RewardReport({Measure("r", "random", name): values for name in names})
    assert result.summary() == {
        "r/random/spearman/mean": 0.5,
        "r/random/spearman/worst": 0.25,
        "r/random/feasible/mean": 0.5,
        "r/random/feasible/worst": 0.75,
    }
    assert result.markdown().splitlines() == [
        "| reward | on | Spearman | Pearson | EPIC | feasible distance | argmax error, m |",
        "| --- | --- | --- | --- | --- | --- | --- |",
        "| r | random | 0.500 (0.250) | – | – | 0.500 (0.750) | – |",
    ]


def test_by_metric_is_the_same_measures_by_their_headings():
    result = report({"r": true})
    by_metric = result.by_metric()
    assert list(by_metric) == [
        "Spearman", "Pearson", "EPIC", "feasible distance", "argmax error, m"
    ]  # fmt: skip
    assert list(by_metric["Spearman"]) == ["r on random", "r on map"]
    expected = result.per_task[Measure("r", "random", "epic")]
    assert torch.equal(by_metric["EPIC"]["r on random"], expected)


def test_without_a_true_reward_of_anything_there_is_no_epic():
    """The other measures are of what happened, and are the same to the bit."""
    batch = coverage()
    batch["next", "reward"] = true(batch).unsqueeze(-1)
    rewards = {"r": lambda b: b["observation"].square().sum(-1)}
    with_epic = report(rewards, batch).per_task
    without = reward_report(
        rewards, None, {"random": batch}, gamma=GAMMA, features=16, positions=GRID, goals=GOALS
    ).per_task
    assert with_epic.keys() - without.keys() == {Measure("r", "random", "epic")}
    for measure, values in without.items():
        assert torch.equal(values, with_epic[measure])
    with pytest.raises(ValueError, match="got no true reward, and transitions without"):
        reward_report(rewards, None, {"random": coverage()}, gamma=GAMMA, features=16)


def test_a_report_is_seeded():
    batch = coverage()
    rewards = {"r": lambda b: b["observation"].square().sum(-1)}
    first, again, other = (report(rewards, batch, seed=s).summary() for s in (0, 0, 1))
    assert first == again
    assert first["r/random/epic/mean"] != other["r/random/epic/mean"]
    assert first["r/random/pearson/mean"] == other["r/random/pearson/mean"]  # nothing is drawn


def test_rewards_of_a_module_differ_by_its_potential():
    module, batch = ShapedReward(2, 2, gamma=GAMMA), coverage()
    with torch.no_grad():
        r, f = (of(module)(batch) for of in (state_reward_of, shaped_reward_of))
        h, following = (
            module.potential(s, batch["context"])
            for s in (batch["observation"], batch["next", "observation"])
        )
    torch.testing.assert_close(r, module.reward(batch["observation"], batch["context"]))
    torch.testing.assert_close(f, r + GAMMA * following - h)
    assert not torch.allclose(f, r, atol=1e-3)
    at_rest = map_of_reward(shaped_reward_of(module), batch, GRID)
    goals = GOALS[:, None, None].expand(3, 40, 40, 2)
    states = GRID.expand(3, 40, 40, 2)
    expected = module.reward(states, goals) - (1 - GAMMA) * module.potential(states, goals)
    torch.testing.assert_close(at_rest, expected.squeeze(-1).double().detach())


def test_a_map_may_observe_more_than_positions():
    batch = coverage()
    batch["observation"] = torch.cat([batch["observation"], torch.zeros(3, 300, 1)], -1)

    def observe(positions):
        return torch.cat([positions, torch.full_like(positions[..., :1], 7.0)], -1)

    image = map_of_reward(lambda b: b["observation"].sum(-1), batch, GRID, observe=observe)
    torch.testing.assert_close(image, (GRID.sum(-1) + 7).double().expand(3, 40, 40))


@pytest.mark.parametrize("wrong", [{"goals": None}, {"positions": None}])
def test_maps_need_positions_and_goals(wrong):
    with pytest.raises(ValueError, match="expected some coverage, none of it named 'map', and"):
        report({"r": true}, **wrong)


@pytest.mark.parametrize("distributions", [{}, {"map": coverage()}])
def test_coverage_is_needed_and_maps_are_apart(distributions):
    with pytest.raises(ValueError, match="expected some coverage"):
        reward_report({"r": true}, true, distributions, gamma=GAMMA)
