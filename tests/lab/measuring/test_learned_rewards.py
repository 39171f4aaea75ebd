"""What a learned reward is measured on: coverage as stated, the environment's own reward."""

import pytest
import torch

from pemirl_lab.measuring.candidates import of_model
from pemirl_lab.measuring.learned_rewards import (
    ReportConfig,
    coverage_of,
    grid,
    measure_reward,
    true_reward,
)
from pemirl_trl import DemonstrationDataset, ModelConfig, PEMIRLModel

from ..conftest import ROOT

TASKS, EPISODES = 4, 3


@pytest.fixture
def demonstrations():
    return DemonstrationDataset.load(ROOT / "data/point_maze_test.safetensors")[:TASKS]


@pytest.fixture
def model():
    return PEMIRLModel(2, 2, 100, ModelConfig())


@pytest.fixture
def given(settings):
    return settings("meta_train", "threads=1", "logger=null")[0]


def test_coverage_is_what_the_report_states(given, model, demonstrations):
    context = model.encoder.get_dist(demonstrations.trajectories()).mean.detach()
    coverage = coverage_of(given, EPISODES, context, demonstrations)
    assert {batch.batch_size for batch in coverage.values()} == {(TASKS, EPISODES * 100)}
    true = true_reward("point_maze/right")
    for batch in coverage.values():
        # Every row is its task's, with its demonstration's m and the reward that it was given.
        assert (batch["task", "goal"] == demonstrations.tasks()["goal"][:, None]).all()
        torch.testing.assert_close(batch["context"], context[:, None].expand(*batch.shape, -1))
        given_ = batch["next", "reward"].squeeze(-1)
        torch.testing.assert_close(true(batch), given_, rtol=0, atol=1e-6)
    random, expert, mixed = coverage.values()
    assert random["action"].abs().max() <= 1
    assert random["action"].std().item() == pytest.approx(3**-0.5, abs=0.02)  # uniform in [-1, 1]
    assert (expert["next", "reward"].mean(1) > random["next", "reward"].mean(1) + 0.2).all()
    half = EPISODES * 50
    assert torch.equal(mixed["observation"][:, :half], random["observation"][:, ::2])
    assert torch.equal(mixed["observation"][:, half:], expert["observation"][:, ::2])


def test_what_a_table_measures_is_what_the_report_measures(settings, given, model, demonstrations):
    """``reward_report.yaml`` has the defaults; and the caller's random state stays."""
    _, own = settings("reward_report")
    assert own.report == ReportConfig()
    few = ReportConfig(episodes=2, resolution=8, epic_transitions=16, epic_samples=8, features=8)
    state = torch.get_rng_state()
    first, second = (
        measure_reward(given, few, of_model(model, demonstrations), demonstrations).summary()
        for _ in range(2)
    )
    assert first == second
    assert torch.equal(torch.get_rng_state(), state)


def test_the_grid_covers_the_plan(given):
    ((x0, x1), (y0, y1)), positions = grid(given, 5)
    assert positions.shape == (5, 5, 2)
    low, high = positions.flatten(0, 1).min(0).values, positions.flatten(0, 1).max(0).values
    assert x0 <= low[0] < high[0] <= x1
    assert y0 <= low[1] < high[1] <= y1
