"""The quickstart: once as a user runs it, and once more, finished."""

import json
import re
import shutil

from pemirl_lab.results import read

WITHOUT_ADAPTATION = {("one_shot", "left"), ("policy_generalisation", "right")}


def test_it_prints_a_table_and_leaves_its_files(smoke):
    cwd, printed = smoke
    cell = r"\| -\d+\.\d\d \(-?\d+\.\d{3}\) "  # return and normalised return of one seed
    assert re.search(rf"\| pemirl_robust \| 1 {cell * 6}\|", printed)
    for name in (
        "config.yaml",
        "versions.json",
        "inputs.json",
        "seconds.json",
        "model.safetensors",
        "meta_il.safetensors",
        "policy.safetensors",
        "figures/reward_maps.png",
        "figures/learning_curve.png",
        "metrics/scalars",
    ):
        assert (cwd / "smoke" / name).exists(), name
    results = {file.stem: read(file) for file in (cwd / "smoke/results").glob("*.json")}
    assert {row: {(s.setting, s.variant) for s in r.scores} for row, r in results.items()} == {
        "meta_il": WITHOUT_ADAPTATION,
        "pemirl_robust": WITHOUT_ADAPTATION | {("reward_adaptation", "right")},
    }
    scores = [s for r in results.values() for s in r.scores]
    assert {len(s.per_task) for s in scores if s.goals == "all"} == {30}
    assert all(r.config["preset"] == "smoke" for r in results.values())
    assert results["pemirl_robust"].curves.keys() == {"pemirl_robust", "adaptation"}
    assert {"meta-il", "pemirl_robust", "adaptation", "evaluation"} <= {
        *results["pemirl_robust"].seconds
    }


def test_everything_it_read_is_noted(smoke):
    inputs = json.loads((smoke[0] / "smoke/inputs.json").read_text(encoding="utf-8"))
    read_ = ["demonstrations", "test demonstrations", "model", "adapted policy"]
    assert list(inputs) == read_


def test_a_finished_run_is_not_trained_again(smoke, command, here):
    shutil.copytree(smoke[0] / "smoke", "smoke")
    kept = ("model.safetensors", "policy.safetensors", "curves/pemirl_robust.json")
    before = [(here / "smoke" / name).read_bytes() for name in kept]
    command("quickstart", ["preset=smoke", "threads=1", "run_dir=smoke"])
    assert [(here / "smoke" / name).read_bytes() for name in kept] == before
    curve = json.loads((here / "smoke/curves/pemirl_robust.json").read_text())
    assert [steps for steps, _ in curve] == [800, 1600]
