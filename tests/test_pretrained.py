"""A model's file is compared with itself before a network is built."""

import dataclasses
import json
from pathlib import Path

import pytest
import torch

from pemirl_trl.files import read_weights, save_weights, write_tensors
from pemirl_trl.modules import CategoricalPolicy, ModelConfig, PEMIRLModel, TrainingFamily
from pemirl_trl.pretrained import load_model, save_model, zoo

GOLDEN = Path(__file__).parent / "golden" / "file_version_1"
SIZES = {"context_dim": 2, "encoder_hidden": (5,), "policy_hidden": (4,), "reward_hidden": (3,)}


def small():
    return PEMIRLModel(3, 2, 4, ModelConfig(**SIZES))


def save_with(path, change):
    """A whole file whose stated sizes are changed."""
    save_model(path, small())
    tensors, metadata = read_weights(path)
    sizes = json.loads(metadata["pemirl_model"])
    changed = change(sizes)
    text = changed if isinstance(changed, str) else json.dumps(changed)
    header = {"metadata": {"pemirl_model": text}}
    write_tensors(path, tensors, kind="weights", header=header)


def config(**changed):
    return lambda sizes: {**sizes, "config": {**sizes["config"], **changed}}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: {**s, "horizon": 10**9}, "not those of a model of its sizes"),
        (lambda s: {**s, "horizon": 0}, "expected positive"),
        (lambda s: {**s, "observation_dim": 10**12}, "map of observations has 3 features"),
        (lambda s: {**s, "action_dim": 2.0}, "'action_dim' is 2.0; expected int"),
        (lambda s: {**s, "action_dim": True}, "'action_dim' is True; expected int"),
        (lambda s: {k: v for k, v in s.items() if k != "horizon"}, r"lacks the fields \['horizon'"),
        (config(encoder_hidden=[60_000, 60_000]), "not those of a model of its sizes"),
        (config(policy_hidden=[4] * 100_000), "no more than 26 layers"),
        (config(policy_hidden=["4"]), "expected positive"),
        (config(context_dim=-1), "damaged"),
        (config(context_dim=10**30), "damaged"),
        (config(encoder="rnn"), "encoder"),
        (config(reward_features=[7]), "reward_features is"),
        (config(reward_features=["a"]), "damaged"),
        (config(depth=2), r"unknown ones \['depth'\]"),
        (lambda s: "{", "not JSON"),
        (lambda s: [], "is a list"),
    ],
)
def test_sizes_that_are_not_the_tensors_are_refused_before_anything_is_built(
    tmp_path, change, message, monkeypatch
):
    path = tmp_path / "model"
    save_with(path, change)
    build = PEMIRLModel.__init__

    def on_no_device(self, *arguments):
        assert torch.empty(0).device.type == "meta"
        build(self, *arguments)

    monkeypatch.setattr(PEMIRLModel, "__init__", on_no_device)
    with pytest.raises(ValueError, match=message) as raised:
        load_model(path)
    assert str(path) in str(raised.value)


def test_the_comparison_draws_no_random_numbers(tmp_path):
    save_model(tmp_path / "model", small())
    torch.manual_seed(3)
    small()
    expected = torch.rand(1)
    torch.manual_seed(3)
    load_model(tmp_path / "model")
    assert torch.equal(torch.rand(1), expected)


def test_a_model_of_file_version_1_still_loads():
    model = load_model(GOLDEN / "model.safetensors")
    assert (model.observation_dim, model.action_dim, model.horizon) == (3, 2, 4)
    assert model.config.context_dim == 2
    tensors, metadata = read_weights(GOLDEN / "model.safetensors")
    assert metadata["task"] == "toy"
    for name, value in model.state_dict().items():
        assert torch.equal(value, tensors[f"model.{name}"])


def test_an_older_config_with_fewer_fields_still_loads(tmp_path):
    def without_features(sizes):
        return {**sizes, "config": {k: sizes["config"][k] for k in SIZES}}

    save_with(tmp_path / "model", without_features)
    assert load_model(tmp_path / "model").config.reward_features is None


def test_a_config_without_widths_has_the_default_ones_which_must_fit(tmp_path):
    def without_widths(sizes):
        return {**sizes, "config": {"context_dim": 2}}

    save_with(tmp_path / "model", without_widths)
    with pytest.raises(ValueError, match="not those of a model of its sizes"):
        load_model(tmp_path / "model")


def test_weights_of_something_else_are_refused(tmp_path):
    save_weights(tmp_path / "w", {"net": torch.nn.Linear(1, 1)}, {"task": "toy"})
    with pytest.raises(ValueError, match=r"/w holds weights \['task'\], expected those of a model"):
        load_model(tmp_path / "w")


# --- by name -----------------------------------------------------------------------------------


def test_a_name_is_a_model_of_the_zoo_unless_a_file_has_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "point_maze").mkdir()  # a folder is no model
    assert load_model("point_maze").horizon == 100
    (tmp_path / "point_maze").rmdir()
    save_model("point_maze", small())
    assert load_model("point_maze").horizon == 4


@pytest.mark.parametrize("name", ["pointmaze", "runs/no/model.safetensors"])
def test_a_wrong_name_is_told_the_right_ones(name):
    message = f"no file {name}, and no model of this name; there are .*{', '.join(zoo())}"
    with pytest.raises(FileNotFoundError, match=message):
        load_model(name)


def with_family(path, change=lambda stated: stated):
    """A file of a model with a training family; what is stated of it is changed."""
    model = small()
    contexts, observations = torch.randn(6, 2), torch.randn(6, 5, 3)
    model.family = TrainingFamily.fit(contexts, observations, model.standardize.scale)
    save_model(path, model)
    tensors, metadata = read_weights(path)
    stated = change(json.loads(metadata["training_family"]))
    facts = {**metadata, "training_family": json.dumps(stated)}
    write_tensors(path, tensors, kind="weights", header={"metadata": facts})
    return model


@pytest.mark.parametrize("measured", [0.7, None])
def test_the_training_family_is_kept_to_the_bit(tmp_path, measured):
    model = with_family(tmp_path / "model")
    model.family = dataclasses.replace(
        model.family, recovered=measured, outdone=measured, displaced=0.1
    )
    save_model(tmp_path / "model", model)
    family = load_model(tmp_path / "model").family
    for name, value in vars(model.family).items():
        there = getattr(family, name)
        assert torch.equal(there, value) if isinstance(value, torch.Tensor) else there == value


def test_an_older_family_does_not_say_what_was_measured(tmp_path):
    new = ("recovered", "outdone", "displaced")
    with_family(tmp_path / "model", lambda s: {k: v for k, v in s.items() if k not in new})
    family = load_model(tmp_path / "model").family
    assert [getattr(family, name) for name in new] == [None] * 3


def test_an_older_file_says_nothing_of_its_family():
    assert load_model(GOLDEN / "model.safetensors").family is None


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: {**s, "low": [1.0, 2.0]}, "expected low of finite numbers"),
        (lambda s: {**s, "high": ["a"] * 3}, "high holds no numbers"),
        (lambda s: {**s, "context_mean": [float("nan")] * 2}, "expected context_mean of finite"),
        (lambda s: {**s, "context_covariance": [[1.0], [2.0, 3.0]]}, "holds no numbers"),
        (lambda s: {k: v for k, v in s.items() if k != "deviation"}, "lacks the fields"),
        (lambda s: {**s, "context_distance": "far"}, "'context_distance' is"),
        (lambda s: {**s, "context_distance": float("inf")}, "expected finite numbers"),
        (lambda s: {**s, "recovered": "all"}, "'recovered' is"),
        (lambda s: {**s, "recovered": float("nan")}, "expected finite numbers"),
        (lambda s: [], "is a list"),
    ],
)
def test_a_damaged_training_family_is_refused_by_name(tmp_path, change, message):
    with_family(tmp_path / "model", change)
    with pytest.raises(ValueError, match=message) as raised:
        load_model(tmp_path / "model")
    assert str(tmp_path / "model") in str(raised.value)


def test_a_model_of_discrete_actions_is_rebuilt_with_its_kind_of_policy(tmp_path):
    model = PEMIRLModel(3, 4, 5, ModelConfig(**SIZES, actions="discrete", policy_scale=0.2))
    save_model(tmp_path / "m.safetensors", model)
    loaded = load_model(tmp_path / "m.safetensors")
    assert loaded.config.actions == "discrete"
    assert isinstance(loaded.policy, CategoricalPolicy)
    for a, b in zip(model.state_dict().values(), loaded.state_dict().values(), strict=True):
        assert torch.equal(a, b)


@pytest.mark.parametrize("changed", [{"actions": "some"}, {"policy_scale": 2.0}])
def test_a_kind_of_actions_that_is_none_is_refused(tmp_path, changed):
    path = tmp_path / "m.safetensors"
    save_with(path, config(**{"actions": "discrete", "policy_scale": 0.1, **changed}))
    with pytest.raises(ValueError, match=f"(?s)m.safetensors is damaged: .*{next(iter(changed))}"):
        load_model(path)
