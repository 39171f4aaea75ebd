"""The reward report: a page, its figures, and what it is refused for."""

import importlib
import json
import re
from pathlib import Path

import pytest
import torch

from pemirl_lab.commands import reward_report
from pemirl_lab.runs.places import RunRefused
from pemirl_trl import Card, ModelConfig, PEMIRLModel, save_reward
from pemirl_trl.pretrained import save_model

from ..conftest import ROOT

MEASURED = [
    *(f"{reward}/{where}/{metric}"
      for where in ("random", "expert", "mixed")
      for reward in "rf"
      for metric in ("spearman", "pearson", "epic", "feasible")),
    *(f"{reward}/map/{metric}" for reward in "rf" for metric in ("spearman", "argmax_error")),
]  # fmt: skip
SMALL = (
    "report.episodes=3", "report.features=16", "report.resolution=10", "evaluation.episodes=1",
    "threads=1", "logger=null", "run_dir=report", "model_file=model.safetensors",
)  # fmt: skip


def test_it_writes_its_page(settings, here):
    save_model("model.safetensors", PEMIRLModel(2, 2, 100, ModelConfig()))
    tiny = ("transfer=true", "adaptation.rollouts=60", "adaptation.optimization.iterations=1")
    report = reward_report.run(*settings("reward_report", *SMALL, *tiny))
    content = json.loads(Path("report/report.json").read_text())
    assert content["summary"] == report.summary()
    assert set(content["per_task"]) == set(MEASURED)
    assert {len(values) for values in content["per_task"].values()} == {30}
    page = Path("report/report.md").read_text()
    assert report.markdown() in page
    assert "300 transitions of uniformly random actions" in page
    for name in ("figures/reward_maps.png", "figures/scatter.png"):
        assert f"({name})" in page
        assert Path("report", name).stat().st_size > 10_000
    returns = content["returns"]
    assert list(returns) == ["self-transfer (point_maze/left)", "shift (point_maze/right)"]
    assert all(r["random"] < r["expert"] for r in returns.values())
    assert (
        f"| shift (point_maze/right) | {returns['shift (point_maze/right)']['random']:.2f} |"
        in page
    )

    html = Path("report/report.html").read_text()
    assert html.count('src="data:image/png;base64,') == 3
    assert not re.search(r"""(?:src|href)=["'](?!data:)""", html)  # it needs no other file
    for row in report.table():
        assert "".join(f"<td>{cell}</td>" for cell in row) in html.replace("<th>", "<td>").replace(
            "</th>", "</td>"
        )


def test_without_a_plan_of_the_task_there_is_no_epic_and_no_map(settings, here):
    """The sweeper's true reward is known where something happened, and nowhere else."""
    save_model("model.safetensors", PEMIRLModel(20, 7, 200, ModelConfig()))
    report = reward_report.run(*settings("reward_report", *SMALL, "task=sweeper"))
    assert {measure.metric for measure in report.per_task} == {"spearman", "pearson", "feasible"}
    assert {measure.where for measure in report.per_task} == {"random", "expert", "mixed"}


MINE = """
import numpy, torch

def tensors(observation, m):
    return -(observation - m).norm(dim=-1)

def arrays(achieved_goal, desired_goal, info):
    return -numpy.linalg.norm(achieved_goal - desired_goal, axis=-1)

def of_states(observation):
    return observation[:, :1]

def of_four(a, b, c, d):
    return a

def one_number(observation, m):
    return torch.zeros(())

def offset(observation, target):
    import pendulum
    return pendulum.true_reward(observation, target).squeeze(-1)
"""


@pytest.fixture
def mine(here, monkeypatch):
    """A module of the user's, with a name that no other test uses."""
    Path("my_rewards.py").write_text(MINE)
    monkeypatch.syspath_prepend(str(here))
    monkeypatch.delitem(__import__("sys").modules, "my_rewards", raising=False)


@pytest.mark.usefixtures("mine")
@pytest.mark.parametrize("how", [("tensors", "torch"), ("arrays", "numpy")])
def test_the_true_reward_as_a_function_is_perfect(settings, how):
    """Minus the distance to the goal is Point-Maze's own reward, but for the cost of actions."""
    words = (f"reward=my_rewards:{how[0]}", f"numbers={how[1]}")
    report = reward_report.run(*settings("reward_report", *SMALL, *words)).summary()
    assert report["r/map/spearman/worst"] > 0.999
    assert report["r/random/epic/worst"] < 0.02
    assert not any(name.startswith("f/") for name in report)
    assert "m is the task itself" in Path("report/report.md").read_text()


@pytest.mark.usefixtures("mine")
def test_a_function_of_states_and_an_encoder_that_says_what_m_is(settings):
    save_model("model.safetensors", PEMIRLModel(2, 2, 100, ModelConfig()))
    words = ("reward=my_rewards:of_states", "encoder_file=model.safetensors")
    reward_report.run(*settings("reward_report", *SMALL, *words))
    assert "demonstration), by model.safetensors" in Path("report/report.md").read_text()


def test_a_file_gives_what_its_model_does(settings, here):
    model = PEMIRLModel(2, 2, 100, ModelConfig())
    save_model("model.safetensors", model)
    save_reward(model, "reward.safetensors", card=Card(domain="toy <maze>"))
    words = ("reward=reward.safetensors", "run_dir=from_file")
    by_model = reward_report.run(*settings("reward_report", *SMALL))
    by_file = reward_report.run(*settings("reward_report", *SMALL, *words))
    assert by_file.summary() == by_model.summary()
    assert "toy &lt;maze&gt;" in Path("from_file/report.html").read_text()


@pytest.mark.usefixtures("mine")
@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("reward=my_rewards:nothing",), "has no function nothing; it has"),
        (("reward=nowhere:f",), "reward=nowhere:f: no module nowhere"),
        (("reward=my_rewards:of_four",), r"takes \(a, b, c, d\); expected"),
        (("reward=my_rewards:one_number",), "a number each"),
        (("reward=nothing.safetensors",), "no file nothing.safetensors, and no model"),
        (("reward=my_rewards:tensors", "transfer=true"), "give model_file=FILE instead"),
        (("reward=point_maze", "encoder_file=x"), "has its own encoder"),
    ],
)
def test_what_is_no_reward_is_said(settings, words, message):
    with pytest.raises((ValueError, FileNotFoundError, RunRefused), match=message):
        reward_report.run(*settings("reward_report", *SMALL, *words))


@pytest.mark.usefixtures("mine")
def test_on_an_environment_of_ones_own(command, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "examples" / "own_pendulum"))
    task = importlib.import_module("pendulum")
    task.demonstrations(5, seed=1).save("tests.safetensors")
    torch.manual_seed(0)
    words = (
        "env=pendulum:make_reversed", "true_reward=my_rewards:offset", "logger=null",
        "test_demonstrations=tests.safetensors", "report.episodes=3", "report.features=16",
    )  # fmt: skip
    command("reward_report", ["reward=my_rewards:offset", "run_dir=own", *words])
    content = json.loads(Path("own/report.json").read_text())
    assert len(content["tasks"]["target"]) == 5
    for where in ("random", "demonstrated", "mixed"):
        assert content["summary"][f"r/{where}/spearman/worst"] == 1
        assert content["summary"][f"r/{where}/epic/worst"] < 1e-3
    assert "<img" in Path("own/report.html").read_text()
    with pytest.raises(SystemExit, match="unknown values"):
        command("reward_report", ["reward=my_rewards:offset", "run_dir=x", "colour=1", *words])
