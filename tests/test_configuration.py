"""Wrong values are refused where they are given, by name; presets are what they say."""

import dataclasses

import pytest

from pemirl_trl import ModelConfig
from pemirl_trl.configuration import typed
from pemirl_trl.methods import (
    METHODS,
    AIRLConfig,
    MetaILConfig,
    MethodConfig,
    PEMIRLConfig,
    PolicyConfig,
    PolicyOptimizationConfig,
    TRPOConfig,
)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: TRPOConfig(max_kl=-1.0), "max_kl\n  Input should be greater than 0"),
        (lambda: TRPOConfig(gamma=-1.0), "gamma\n  Input should be greater than or equal to 0"),
        (lambda: TRPOConfig(standardize="none"), "standardize\n  Input should be 'batch' or 'con"),
        (lambda: PEMIRLConfig(iterations="abc"), "iterations\n  Input should be a valid integer"),
        (lambda: PEMIRLConfig(iterations=True), "iterations\n  Input should be a valid integer"),
        (lambda: PEMIRLConfig(iterations=2.0), "iterations\n  Input should be a valid integer"),
        (
            lambda: MetaILConfig(steps=10**12),
            "steps\n  Input should be less than or equal to 10000000",
        ),
        (lambda: PEMIRLConfig(iterations=0), "iterations\n  Input should be greater than or equal"),
        (
            lambda: PEMIRLConfig(gradient_penalty_coeff=float("nan")),
            "gradient_penalty_coeff\n  Input should be a finite number",
        ),
        (lambda: PEMIRLConfig(info_coef=1.0), "info_coef\n  Unexpected keyword argument"),
        (lambda: PEMIRLConfig(batch={"jitter_fraction": 2}), r"batch\.jitter_fraction"),
        (lambda: PEMIRLConfig(policy_reward="f"), "policy_reward\n  Input should be 'state'"),
        (lambda: MetaILConfig(lr=float("inf")), "lr\n  Input should be a finite number"),
        (lambda: ModelConfig(context_dim=-1), "context_dim\n  Input should be greater than or"),
        (lambda: ModelConfig(reward_features=[0, 1.5]), r"reward_features\.1"),
        (lambda: PolicyConfig(anneal_begin=0.9, anneal_finish=0.5), "expected the first to be"),
        (
            lambda: PolicyConfig(imitation_coeff=0.0, final_imitation_coeff=1.0),
            "final_imitation_coeff needs an imitation_coeff above 0",
        ),
        (
            lambda: MethodConfig(algorithm="airl"),
            "algorithm 'airl' takes a training of AIRLConfig, got PEMIRLConfig",
        ),
        (
            lambda: MethodConfig(model=ModelConfig(context_dim=0)),
            "initial_encoder=meta_il needs contexts; got context_dim=0",
        ),
        (lambda: MethodConfig(initial_encoder="anything"), "initial_encoder\n  Input should be"),
    ],
)
def test_a_wrong_value_is_refused_by_name(build, message):
    with pytest.raises(ValueError, match=message):
        build()


def test_the_defaults_are_the_papers_method():
    assert METHODS["pemirl"] == MethodConfig()
    assert METHODS["pemirl"].training == PEMIRLConfig() == PEMIRLConfig.paper()


def test_a_method_and_its_preset_are_one_thing():
    assert METHODS["pemirl_robust"].training == PEMIRLConfig.robust()
    assert METHODS["pemirl_contrastive"].training == PEMIRLConfig.contrastive()
    assert PolicyOptimizationConfig.adaptation().imitate_best == 1.0


def test_without_the_information_term_it_is_airl_with_contexts():
    shared = {f.name for f in dataclasses.fields(AIRLConfig)}
    with_info, without = METHODS["pemirl"].training, METHODS["pemirl_no_info"].training
    assert {n: getattr(with_info, n) for n in shared} == {n: getattr(without, n) for n in shared}


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"stepz": 3}, r"^unknown key stepz \(did you mean steps\?\)$"),
        ({"epochs": 3}, r"^unknown key epochs; expected one of \['steps', "),
    ],
)
def test_an_unknown_name_is_refused_with_those_that_there_are(values, message):
    with pytest.raises(ValueError, match=message):
        typed(MetaILConfig, values)


def test_of_a_nested_name_those_beside_it_are_said():
    with pytest.raises(ValueError, match=r"unknown key batch.trajectory \(did you mean trajector"):
        typed(PEMIRLConfig, {"batch": {"trajectory": 3}})
