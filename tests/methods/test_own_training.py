"""Meta-training in one call: what it makes, what it refuses, and that it resumes."""

import logging
import re

import pytest
import torch

from pemirl_trl import infer, load_model, meta_train, save_model
from pemirl_trl.methods.own_training import digest

TINY = {
    "model": {"context_dim": 2},
    "meta_il": {"steps": 4, "steps_per_iteration": 2},
    "contexts_per_batch": 2,
    "training": {"iterations": 2, "rollouts_per_context": 2, "batch": {"trajectories": 8}},
}


@pytest.fixture
def pile(dataset):
    return dataset(torch.linspace(-1.0, 1.0, 6).unsqueeze(-1))


def same(a, b):
    pairs = zip(a.state_dict().values(), b.state_dict().values(), strict=True)
    return all(torch.equal(x, y) for x, y in pairs)


def test_a_training_is_that_of_its_seed(make_env, pile):
    models = [meta_train(make_env, pile, seed=seed, **TINY) for seed in (0, 0, 1)]
    assert same(models[0], models[1])
    assert not same(models[0], models[2])


def test_a_file_of_demonstrations_serves_as_well(make_env, pile, tmp_path):
    pile.save(tmp_path / "pile.safetensors")
    by_name = meta_train(make_env, tmp_path / "pile.safetensors", **TINY)
    assert same(by_name, meta_train(make_env, pile, **TINY))


def test_both_stages_report_and_no_true_return_is_known(make_env, pile):
    seen = []
    meta_train(make_env, pile, on_iteration=lambda *report: seen.append(report), **TINY)
    assert [(stage, i) for stage, i, _ in seen] == [
        ("meta-il", 1),
        ("meta-il", 2),
        ("meta-training", 1),
        ("meta-training", 2),
    ]
    assert not any("return/true" in metrics for _, _, metrics in seen)
    assert "return/learned" in seen[-1][2]


def test_the_settings_are_logged(make_env, pile, caplog):
    with caplog.at_level(logging.INFO, "pemirl_trl"):
        meta_train(make_env, pile, **TINY)
    assert "meta-training with preset robust" in caplog.text
    assert re.search(r"training\.rollouts_per_context +2\n", caplog.text)


def test_the_same_call_resumes_what_died(make_env, pile, tmp_path):
    class KilledError(RuntimeError):
        pass

    def kill(stage, iteration, metrics):
        if stage == "meta-training":
            raise KilledError

    with pytest.raises(KilledError):
        meta_train(make_env, pile, checkpoint=tmp_path, on_iteration=kill, **TINY)
    stages = []
    resumed = meta_train(
        make_env,
        pile,
        checkpoint=tmp_path,
        on_iteration=lambda stage, *rest: stages.append(stage),
        **TINY,
    )
    assert set(stages) == {"meta-training"}
    assert same(resumed, meta_train(make_env, pile, **TINY))


def test_the_model_knows_its_family_also_from_its_file(make_env, pile, tmp_path):
    model = meta_train(make_env, pile, **TINY)
    save_model(tmp_path / "model.safetensors", model)
    loaded = load_model(tmp_path / "model.safetensors")
    for name, value in vars(model.family).items():
        there = getattr(loaded.family, name)
        assert torch.equal(there, value) if isinstance(value, torch.Tensor) else there == value
    assert str(infer(loaded, pile[0])) == str(infer(model, pile[0]))
    assert model.family.context_distance == pytest.approx(
        max(infer(model, pile[i]).distance.context for i in range(6)), rel=1e-3
    )


def test_contrastive_needs_a_task_space_before_anything_is_trained(make_env, pile):
    def fail(*report):
        raise AssertionError

    with pytest.raises(ValueError, match="say which components"):
        meta_train(make_env, pile, "contrastive", on_iteration=fail, **TINY)
    model = meta_train(make_env, pile, "contrastive", task_space=[0], **TINY)
    assert model.reward.reward_features == [0]


def test_the_published_method_trains_as_well(make_env, pile):
    assert meta_train(make_env, pile, "paper", **TINY).family is not None


def test_a_wrong_environment_is_refused_before_anything_is_trained(make_env, pile):
    def longer(num_envs, seed):
        env = make_env(num_envs, seed)
        env.horizon = 12
        return env

    def fail(*report):
        raise AssertionError

    with pytest.raises(ValueError, match="its episodes last 12 steps, and the model's 10"):
        meta_train(longer, pile, on_iteration=fail, **TINY)


def test_something_else_than_demonstrations_is_refused(make_env):
    with pytest.raises(TypeError, match="got demonstrations of type list; expected a Demonstr"):
        meta_train(make_env, [])


def test_a_digest_tells_demonstrations_apart(pile):
    assert digest(pile) == digest(pile[:])
    assert digest(pile) != digest(pile[:5])


def test_one_demonstration_is_no_family_and_is_refused_before_anything_is_trained(make_env, pile):
    with pytest.raises(ValueError, match="got 1 demonstration to meta-train on; expected those of"):
        meta_train(make_env, pile[0], **TINY)


@pytest.mark.parametrize("space", [["x"], [1], [0, 0], [], 1])
def test_a_task_space_is_of_numbers_of_components(make_env, pile, space):
    with pytest.raises(ValueError, match=r"task_space=.*: expected distinct numbers from 0 to 0"):
        meta_train(make_env, pile, "contrastive", task_space=space, **TINY)


def test_a_task_space_that_r_would_not_read_is_refused(make_env, pile):
    with pytest.raises(ValueError, match=r"got task_space=\[0\], which r does not read here"):
        meta_train(make_env, pile, task_space=[0], **TINY)


def test_what_is_suspicious_about_demonstrations_is_said_by_call_too(make_env, pile, caplog):
    meta_train(make_env, pile, **TINY)
    assert "few demonstrations (6 in all)" in caplog.text
