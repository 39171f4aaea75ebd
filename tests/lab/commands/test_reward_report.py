"""The reward report: a page, its figures, and what it is refused for."""

import json
import re
from pathlib import Path

import pytest

from pemirl_lab.commands import reward_report
from pemirl_trl import ModelConfig, PEMIRLModel
from pemirl_trl.pretrained import save_model

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


@pytest.mark.parametrize("task", ["ant", "sweeper", "sawyer_pusher"])
def test_a_task_without_a_map_is_refused(settings, here, task):
    message = re.escape(f"task={task} is not planar: this report needs the true reward of")
    with pytest.raises(ValueError, match=message):
        reward_report.run(*settings("reward_report", *SMALL, f"task={task}"))
    assert list(here.iterdir()) == []
