"""The reward report: coverage as stated, the environment's own reward, and a page."""

import importlib
import json
import pathlib

import pytest
import torch
from hydra import compose, initialize_config_dir
from omegaconf import open_dict

from pemirl_trl import DemonstrationDataset, ModelConfig, PEMIRLModel
from pemirl_trl.pretrained import save_model

ROOT = pathlib.Path(__file__).parents[2]
TASKS, EPISODES = 4, 3
MEASURED = [
    *(f"{reward}/{where}/{metric}"
      for where in ("random", "expert", "mixed")
      for reward in "rf"
      for metric in ("spearman", "pearson", "epic", "feasible")),
    *(f"{reward}/map/{metric}" for reward in "rf" for metric in ("spearman", "argmax_error")),
]  # fmt: skip


@pytest.fixture
def recipe(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "recipes"))
    return importlib.import_module("reward_report")


@pytest.fixture
def demonstrations():
    return DemonstrationDataset.load(ROOT / "data/point_maze_test.safetensors")[:TASKS]


@pytest.fixture
def model():
    return PEMIRLModel(2, 2, 100, ModelConfig())


def config(*overrides):
    small = (f"report.episodes={EPISODES}", "report.features=16", "report.resolution=10")
    with initialize_config_dir(str(ROOT / "recipes/conf"), version_base="1.3"):
        return compose("reward_report", ["threads=1", "logger=null", *small, *overrides])


def test_coverage_is_what_the_report_states(recipe, model, demonstrations):
    coverage = recipe.coverage_of(config(), model, demonstrations)
    assert {batch.batch_size for batch in coverage.values()} == {(TASKS, EPISODES * 100)}
    true = recipe.true_reward("point_maze/right", "goal")
    context = model.encoder.get_dist(demonstrations.trajectories()).mean
    for batch in coverage.values():
        # Every row is its task's, with its demonstration's m and the reward that it was given.
        assert (batch["task", "goal"] == demonstrations.tasks()["goal"][:, None]).all()
        torch.testing.assert_close(batch["context"], context[:, None].expand(*batch.shape, -1))
        given = batch["next", "reward"].squeeze(-1)
        torch.testing.assert_close(true(batch), given, rtol=0, atol=1e-6)
    random, expert, mixed = coverage.values()
    assert random["action"].abs().max() <= 1
    assert random["action"].std().item() == pytest.approx(3**-0.5, abs=0.02)  # uniform in [-1, 1]
    assert (expert["next", "reward"].mean(1) > random["next", "reward"].mean(1) + 0.2).all()
    half = EPISODES * 50
    assert torch.equal(mixed["observation"][:, :half], random["observation"][:, ::2])
    assert torch.equal(mixed["observation"][:, half:], expert["observation"][:, ::2])


def test_another_recipe_may_measure_without_a_section_of_its_own(recipe, model, demonstrations):
    """The values of ``reward_report.yaml`` are the defaults; the caller's random state stays."""
    values = config("report.episodes=5", "report.features=64", "report.resolution=60")
    bare = config()
    with open_dict(bare):
        del bare["report"]
    state = torch.get_rng_state()
    assert (
        recipe.measure_reward(bare, model, demonstrations).summary()
        == recipe.measure_reward(values, model, demonstrations).summary()
    )
    assert torch.equal(torch.get_rng_state(), state)


def test_the_recipe_writes_its_page(recipe, model, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_model("model.safetensors", model)
    tiny = (
        "transfer=true",
        "adaptation.rollouts=60",
        "adaptation.optimization.iterations=1",
        "evaluation.episodes=1",
    )
    values = config("model_file=model.safetensors", "run_dir=report", *tiny)
    report = recipe.write_report(values, recipe.RunFolder(values), model)
    content = json.loads(pathlib.Path("report/report.json").read_text())
    assert content["summary"] == report.summary()
    assert set(content["per_task"]) == set(MEASURED)
    assert {len(values) for values in content["per_task"].values()} == {30}
    page = pathlib.Path("report/report.md").read_text()
    assert report.markdown() in page
    for name in ("figures/reward_maps.png", "figures/scatter.png"):
        assert f"({name})" in page
        assert pathlib.Path("report", name).stat().st_size > 10_000
    returns = content["returns"]
    assert list(returns) == ["self-transfer (point_maze/left)", "shift (point_maze/right)"]
    assert all(r["random"] < r["expert"] for r in returns.values())
    assert (
        f"| shift (point_maze/right) | {returns['shift (point_maze/right)']['random']:.2f} |"
        in page
    )
