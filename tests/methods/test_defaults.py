"""Settings that demonstrations say, and what a user says instead."""

from typing import get_args

import pytest
import torch

from pemirl_trl import DemonstrationDataset, ModelConfig, PEMIRLModel
from pemirl_trl.methods import (
    METHODS,
    PRESETS,
    MetaILConfig,
    PolicyOptimizationConfig,
    adaptation_config,
    candidates,
    initial_policy,
    meta_training_config,
)
from pemirl_trl.methods.defaults import (
    LEAST_ITERATIONS,
    Exploration,
    found_for_adaptation,
    found_for_meta_training,
    table,
)


def data(count=100, horizon=100, size=1.0):
    action = size * torch.ones(count, horizon, 1)
    return DemonstrationDataset(torch.randn(count, horizon + 1, 3), action)


def model(**sizes):
    return PEMIRLModel(3, 1, 100, ModelConfig(**sizes))


def test_budgets_are_those_of_point_maze_at_its_horizon():
    config = meta_training_config(data())
    assert (config.contexts_per_batch, config.training.rollouts_per_context) == (50, 8)
    assert config.training.iterations == 50
    assert config.meta_il.kl_coeff == 0.001
    adaptation = adaptation_config(model(), data(30))
    assert (adaptation.rollouts, adaptation.optimization.iterations) == (180, 72)


@pytest.mark.parametrize("horizon", [5, 20, 50, 200, 1000])
@pytest.mark.parametrize("count", [2, 10, 400])
def test_budgets_are_kept_at_every_horizon_or_the_least_iterations_are_done(horizon, count):
    config = meta_training_config(data(count, horizon))
    steps = config.contexts_per_batch * config.training.rollouts_per_context * horizon
    total = steps * config.training.iterations
    assert config.training.iterations == LEAST_ITERATIONS or 1.8e6 < total < 2.2e6
    assert config.training.rollouts_per_context >= 2
    assert config.contexts_per_batch <= count
    adaptation = adaptation_config(model(), data(count, horizon))
    total = adaptation.rollouts * horizon * adaptation.optimization.iterations
    assert adaptation.optimization.iterations == LEAST_ITERATIONS or 1.2e6 < total < 1.4e6
    assert adaptation.rollouts >= 4 * count


def test_demonstrations_are_read_in_parts_but_by_the_published_method():
    kept = [meta_training_config(data(), preset).meta_il for preset in ("robust", "contrastive")]
    assert all((m.part_share, m.lr, m.lr_schedule) == (0.5, 2e-3, "cosine") for m in kept)
    published, default = meta_training_config(data(), "paper").meta_il, MetaILConfig()
    for name in ("part_share", "lr", "lr_schedule"):
        assert getattr(published, name) == getattr(default, name)


def test_the_weight_of_kl_is_a_tenth_of_the_evidence_bounds_own():
    weights = [meta_training_config(data(4, horizon)).meta_il.kl_coeff for horizon in (10, 500)]
    assert weights == [0.01, 0.0002]


def test_deviations_are_in_units_of_the_demonstrated_actions():
    one, ten = (adaptation_config(model(policy_scale=size), data()) for size in (1.0, 10.0))
    assert ten.policy_scale == 10.0 * one.policy_scale == 30.0
    assert ten.optimization.final_scale == 10.0 * one.optimization.final_scale
    assert ten.optimization.imitate_best == pytest.approx(one.optimization.imitate_best / 100.0)
    config = meta_training_config(data(size=10.0))
    assert (config.model.policy_scale, config.training.policy.final_scale) == (10.0, 3.0)


def test_the_robust_reward_does_not_depend_on_the_units_of_actions():
    batches = {preset: meta_training_config(data(), preset).training.batch for preset in PRESETS}
    relative = {preset: batch.relative_log_prob for preset, batch in batches.items()}
    assert relative == {"paper": False, "robust": True, "contrastive": True}


def test_demonstrations_of_other_tasks_are_negatives_of_the_robust_reward():
    batches = {preset: meta_training_config(data(), preset).training.batch for preset in PRESETS}
    shares = {preset: batch.mismatched_fraction for preset, batch in batches.items()}
    assert shares == {"paper": 0.0, "robust": 0.25, "contrastive": 0.5}


def test_actions_that_are_all_zero_are_refused():
    with pytest.raises(ValueError, match="the demonstrated actions are all 0"):
        meta_training_config(data(size=0.0))


@pytest.mark.parametrize("preset", ["paper", "robust", "contrastive"])
def test_a_preset_is_the_librarys_method_but_for_what_was_found(preset):
    names = {"paper": "pemirl"}
    base = METHODS[names.get(preset, f"pemirl_{preset}")]
    config = meta_training_config(data(), preset)
    assert config.training.gradient_penalty_coeff == base.training.gradient_penalty_coeff
    assert config.training.batch.jitter_fraction == base.training.batch.jitter_fraction
    assert config.reward_reads == base.reward_reads
    assert config.learn_policy_scale == base.learn_policy_scale


def test_a_given_setting_counts_alone_and_nested_ones_leave_the_rest():
    given = {"meta_il": MetaILConfig(steps=100), "training": {"iterations": 7}}
    config = meta_training_config(data(), overrides={**given, "contexts_per_batch": 10})
    assert config.meta_il == MetaILConfig(steps=100)  # a whole configuration is taken as it is
    assert config.training.iterations == 7
    assert config.training.gradient_penalty_coeff == 0.1
    assert config.contexts_per_batch == 10


def test_iterations_follow_from_given_rollouts():
    config = meta_training_config(data(), overrides={"training": {"rollouts_per_context": 4}})
    assert config.training.iterations == 100
    whole = {"optimization": PolicyOptimizationConfig(iterations=3)}
    assert adaptation_config(model(), data(), whole).optimization.iterations == 3
    assert adaptation_config(model(), data(), {"rollouts": 100}).optimization.iterations == 130


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"training": {"iteratons": 3}}, "unknown key training.iteratons"),
        ({"training": {"iterations": 0}}, "training.iterations=0: expected greater than"),
        ({"contexts": 3}, "unknown key contexts"),
    ],
)
def test_a_wrong_setting_is_named(overrides, message):
    with pytest.raises(ValueError, match=message):
        meta_training_config(data(), overrides=overrides)


def test_an_unknown_preset_lists_those_that_there_are():
    with pytest.raises(ValueError, match=r"unknown preset 'best'; choose one of \['paper', 'rob"):
        meta_training_config(data(), "best")


def test_the_table_shows_what_is_used():
    overrides = {"training": {"iterations": 7}}
    found = found_for_meta_training(data(), "robust", overrides)
    text = table(found, meta_training_config(data(), overrides=overrides))
    lines = [line.split() for line in text.splitlines()]
    assert ["training.iterations", "7"] in lines
    assert ["meta_il.kl_coeff", "0.001"] in lines
    assert ["training.batch.relative_log_prob", "True"] in lines
    for way in get_args(Exploration):
        found = found_for_adaptation(model(), data(), exploration=way)
        config = adaptation_config(model(), data(), exploration=way)
        lines = [line.split() for line in table(found, config).splitlines()]
        final = config.optimization.final_scale
        assert ["optimization.final_scale", f"{final:g}" if final else "None"] in lines


def test_a_narrow_exploration_learns_a_smaller_deviation_and_imitates_no_best():
    wide, narrow = (
        adaptation_config(model(policy_scale=10.0), data(), exploration=way)
        for way in get_args(Exploration)
    )
    assert (wide.policy_scale, narrow.policy_scale) == (30.0, 5.0)
    assert (wide.learn_policy_scale, narrow.learn_policy_scale) == (False, True)
    assert narrow.optimization.final_scale is None
    assert narrow.optimization.imitate_best == 0.0 < wide.optimization.imitate_best
    assert narrow.optimization.iterations == wide.optimization.iterations
    assert narrow.rollouts == wide.rollouts


def test_choices_are_explored_in_one_way():
    one_hot = PEMIRLModel(2, 3, 40, ModelConfig(actions="discrete", policy_scale=0.3))
    names = [way.name for way in candidates(one_hot, choices(10), {})]
    assert names == ["fresh-wide", "trained-wide"]
    with pytest.raises(ValueError, match=r"'narrow'; choose one of \['wide'\]"):
        candidates(one_hot, choices(10), {}, "narrow")
    configs = [
        adaptation_config(one_hot, choices(10), exploration=w) for w in get_args(Exploration)
    ]
    assert configs[0] == configs[1]


def choices(count=100, horizon=40):
    action = torch.eye(3)[torch.randint(3, (count, horizon))]
    return DemonstrationDataset(torch.randn(count, horizon + 1, 2), action)


@pytest.mark.parametrize("preset", ["paper", "robust"])
def test_one_hot_actions_ask_for_a_categorical_policy_with_shares_for_deviations(preset):
    config = meta_training_config(choices(), preset)
    assert config.model.actions == "discrete"
    assert 0 < config.model.policy_scale < 1
    assert not config.learn_policy_scale
    final = config.training.policy.final_scale
    assert (final is None) == (preset != "robust")
    assert final is None or final < config.model.policy_scale
    text = table(found_for_meta_training(choices(), preset), config)
    assert ["model.actions", "discrete"] in [line.split() for line in text.splitlines()]
    one_hot = PEMIRLModel(2, 3, 40, config.model)
    adaptation = adaptation_config(one_hot, choices(10))
    assert 1 > adaptation.policy_scale > adaptation.optimization.final_scale > 0


@pytest.mark.parametrize("given", [{"actions": "continuous"}, ModelConfig()])
def test_one_hot_actions_that_are_meant_as_numbers_stay_numbers(given):
    config = meta_training_config(choices(), overrides={"model": given})
    assert config.model.actions == "continuous"
    assert config == meta_training_config(
        choices(), overrides={"model": {"actions": "continuous", **dict(vars(config.model))}}
    )


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"learn_policy_scale": True}, "a policy of discrete actions learns none"),
        ({"training": {"policy": {"final_scale": 1.5}}}, "final_scale is 1.5; of discrete"),
        ({"model": {"policy_scale": 2.0}}, "policy_scale is 2.0; of discrete"),
        ({"model": {"actions": "some"}}, "model.actions"),
    ],
)
def test_deviations_that_no_choice_has_are_refused(overrides, message):
    with pytest.raises(ValueError, match=message):
        meta_training_config(choices(), overrides=overrides)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"policy_scale": 3.0}, "policy_scale is 3.0; of discrete"),
        ({"optimization": {"final_scale": 1.0}}, "final_scale is 1.0; of discrete"),
        ({"learn_policy_scale": True}, "a policy of discrete actions learns none"),
    ],
)
def test_they_are_refused_before_adaptation_too(overrides, message):
    one_hot = PEMIRLModel(2, 3, 40, ModelConfig(actions="discrete", policy_scale=0.3))
    with pytest.raises(ValueError, match=message):
        initial_policy(one_hot, adaptation_config(one_hot, choices(10), overrides))
