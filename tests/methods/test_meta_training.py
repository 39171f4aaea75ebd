"""Whole methods by name: what they build, and where they start."""

import dataclasses

import pytest
import torch

from pemirl_trl import DemonstrationDataset
from pemirl_trl.methods import (
    AIRL,
    METHODS,
    PEMIRL,
    AdaptationConfig,
    AveragedReward,
    MetaInfoGAIL,
    MethodConfig,
    build,
    initial_policy,
    new_model,
    start_from,
)

KINDS = {"pemirl": PEMIRL, "airl": AIRL, "meta_infogail": MetaInfoGAIL}


@pytest.fixture
def demonstrations(reach):
    steps = reach.demonstrations
    last = steps["next", "observation"][:, -1:]
    return DemonstrationDataset(torch.cat([steps["observation"], last], 1), steps["action"])


@pytest.mark.parametrize("name", sorted(set(METHODS) - {"meta_il"}))
def test_a_method_is_built_of_its_name_and_trains(name, reach, demonstrations):
    method = METHODS[name]
    small = dataclasses.replace(
        method, training=dataclasses.replace(method.training, rollouts_per_context=2)
    )
    model = new_model(demonstrations, small, task_space=[0])
    start_from(model, new_model(demonstrations, MethodConfig()), small)
    built = build(small, model, reach.env(model, 3, 2), demonstrations.trajectories())
    averaged = isinstance(built, AveragedReward)
    assert averaged == (small.reward_average_decay is not None)
    inner = built.method if averaged else built
    assert type(inner) is KINDS[small.algorithm]
    before = [p.clone() for p in model.reward.parameters()]
    metrics = built.iteration()
    assert metrics["reward/magnitude"] > 0
    assert any(
        not torch.equal(a, b) for a, b in zip(before, model.reward.parameters(), strict=True)
    )


def test_meta_il_has_no_adversarial_method(reach, demonstrations):
    model = new_model(demonstrations, METHODS["meta_il"])
    with pytest.raises(ValueError, match="Meta-IL trains no reward"):
        build(METHODS["meta_il"], model, reach.env(model, 2, 2), demonstrations.trajectories())


def test_another_information_term_needs_one_to_replace(reach, demonstrations):
    model = new_model(demonstrations, METHODS["airl"])
    env, steps = reach.env(model, 2, 16), demonstrations.trajectories()
    with pytest.raises(ValueError, match="airl has no information term to replace"):
        build(METHODS["airl"], model, env, steps, info_loss=lambda td: td)


def test_a_reward_of_the_task_space_needs_to_be_told_what_that_is(demonstrations):
    contrastive = METHODS["pemirl_contrastive"]
    with pytest.raises(ValueError, match="say which components of an observation the task"):
        new_model(demonstrations, contrastive)
    assert new_model(demonstrations, contrastive, task_space=[0]).config.reward_features == [0]
    assert (
        new_model(demonstrations, METHODS["pemirl"], task_space=[0]).config.reward_features is None
    )


def test_encoder_and_policy_start_where_the_method_says(demonstrations):
    trained = new_model(demonstrations, MethodConfig())
    for encoder in ("meta_il", "fresh"):
        for policy in ("meta_il", "fresh"):
            config = MethodConfig(initial_encoder=encoder, initial_policy=policy)
            model = new_model(demonstrations, config)
            start_from(model, trained, config)
            for name, start in (("encoder", encoder), ("policy", policy)):
                pairs = zip(
                    getattr(model, name).parameters(),
                    getattr(trained, name).parameters(),
                    strict=True,
                )
                same = all(torch.equal(a, b) for a, b in pairs)
                assert same == (start == "meta_il"), (name, start)
            assert model.policy.log_scale.requires_grad
    with pytest.raises(ValueError, match="initial_encoder=meta_il needs Meta-IL's model; got none"):
        start_from(trained, None, MethodConfig())
    held = MethodConfig(learn_policy_scale=False)
    start_from(model, trained, held)
    assert not model.policy.log_scale.requires_grad


def test_adaptation_starts_from_the_policy_that_was_asked_for(reach):
    model = reach.model()
    batch = reach.demonstrations[:2].select("observation").copy()
    batch.set("context", torch.randn(2, reach.horizon, 3))
    kept = model.policy.get_dist(batch.copy()).mean
    for which, same, activation in (("fresh", False, "tanh"), ("trained", True, "relu")):
        policy, named = initial_policy(model, AdaptationConfig(initial_policy=which))
        assert torch.equal(policy.get_dist(batch.copy()).mean, kept) == same
        assert named == activation
        assert policy.log_scale.exp().detach().mean() == pytest.approx(3.0)
