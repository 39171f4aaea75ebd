"""Scores: which demonstrations, which goals, and beside what."""

import dataclasses

import pytest
import torch

from pemirl_lab.measuring.scores import Scorer, context_measures, load_test_demonstrations
from pemirl_trl import ModelConfig, PEMIRLModel
from pemirl_trl.pretrained import load_model


def test_one_demonstration_of_each_unseen_task_is_used(settings):
    given, _ = settings("meta_train", "task=ant")
    used = load_test_demonstrations(given)
    assert used.tasks()["direction"].flatten().tolist() == [1.0, -1.0]
    given, _ = settings("meta_train")
    assert len(load_test_demonstrations(given)) == 30


@pytest.fixture(scope="module")
def scored(smoke, settings):
    """Settings, a scorer, the quickstart's model, and the scores of its policy."""
    given, _ = settings("meta_train", "evaluation.episodes=1", "threads=1")
    scorer = Scorer(given, load_test_demonstrations(given))
    model = load_model(smoke[0] / "smoke/model.safetensors")
    used = {"meta_training": 7, "adaptation": 0}
    where = ("one_shot", "point_maze/left")
    return given, scorer, model, scorer.scores(*where, model, model.policy, used)


def test_a_subset_is_scored_on_its_own_tasks(scored):
    _, scorer, _, scores = scored
    every, some = scores
    assert (every.goals, some.goals) == ("all", "x_in_0.1_0.4")
    x = scorer.demonstrations.tasks()["goal"][:, 0]
    chosen = ((x >= 0.1) & (x <= 0.4)).tolist()
    of_all = [value for value, inside in zip(every.per_task, chosen, strict=True) if inside]
    assert list(some.per_task) == of_all
    assert 0 < len(of_all) < 30
    references = scorer.references("point_maze/left")
    assert some.expert == pytest.approx(float(references["expert"][torch.tensor(chosen)].mean()))
    assert every.random < every.expert
    assert every.env_steps == {"meta_training": 7, "adaptation": 0}


def test_references_are_measured_once(scored):
    _, scorer, *_ = scored
    first = scorer.references("point_maze/left")
    assert scorer.references("point_maze/left") is first
    assert (first["expert"] > first["random"]).all()


def test_a_probe_reads_the_task_off_the_contexts(scored):
    given, _, model, _ = scored
    measures = context_measures(given, model)
    assert list(measures) == ["context/r2"]
    assert measures["context/r2"] <= 1
    without = PEMIRLModel(2, 2, 100, dataclasses.replace(ModelConfig(), context_dim=0))
    assert context_measures(given, without) == {}
