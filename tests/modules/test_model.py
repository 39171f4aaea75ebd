"""A model: its networks share a map, and its numbers and weights rebuild it."""

import dataclasses

import pytest
import torch
from tensordict import TensorDict
from torch import nn

from pemirl_trl.modules import (
    AttentionContextEncoder,
    ContextEncoder,
    GAILDiscriminator,
    MaskedContextEncoder,
    ModelConfig,
    NoContext,
    PEMIRLModel,
    ShapedReward,
    Standardize,
)
from pemirl_trl.pretrained import load_model, save_model

N, T, S, A = 5, 4, 3, 2
KINDS = [
    ({"context_dim": 2}, ContextEncoder, ShapedReward),
    ({"context_dim": 2, "reward_features": (2, 0)}, ContextEncoder, ShapedReward),
    ({"context_dim": 0}, NoContext, ShapedReward),
    ({"context_dim": 2, "encoder": "masked"}, MaskedContextEncoder, ShapedReward),
    ({"context_dim": 2, "encoder": "attention"}, AttentionContextEncoder, ShapedReward),
    ({"context_dim": 2, "reward": "gail"}, ContextEncoder, GAILDiscriminator),
    ({"context_dim": 0, "reward": "gail"}, NoContext, GAILDiscriminator),
]


def model(**config):
    standardize = Standardize(torch.randn(S), torch.rand(S) + 0.5)
    return PEMIRLModel(S, A, T, ModelConfig(**config), standardize)


def outputs(m):
    """What the three networks make of one batch of trajectories and its inferred contexts."""
    torch.manual_seed(1)
    trajectories = {"observation": torch.randn(N, T, S), "action": torch.randn(N, T, A)}
    q = m.encoder.get_dist(TensorDict(trajectories, [N]))
    context = q.mean.unsqueeze(1).expand(N, T, -1)
    steps = {**trajectories, "context": context, "next": {"observation": torch.randn(N, T, S)}}
    reward = m.reward(TensorDict(steps, [N, T]))
    policy = m.policy.get_dist(TensorDict(steps, [N, T]))
    return [q.mean, q.stddev, reward["learned_reward"], policy.mean, policy.stddev]


@pytest.mark.parametrize(("config", "encoder", "reward"), KINDS)
def test_a_model_of_every_kind_comes_back_from_its_file(config, encoder, reward, tmp_path):
    source = model(**config)
    save_model(tmp_path / "model.safetensors", source)
    loaded = load_model(tmp_path / "model.safetensors")
    assert (type(loaded.encoder), type(loaded.reward)) == (encoder, reward)
    for field in dataclasses.fields(ModelConfig):
        got, value = (getattr(m.config, field.name) for m in (loaded, source))
        assert list(got) == list(value) if isinstance(value, tuple) else got == value
    for got, value in zip(outputs(loaded), outputs(source), strict=True):
        assert torch.equal(got, value)
    assert [x.shape[-1] for x in outputs(loaded)] == [config["context_dim"]] * 2 + [1, A, A]


@pytest.mark.parametrize(("config", "encoder", "reward"), KINDS)
def test_its_networks_share_one_map(config, encoder, reward):
    m = model(**config)
    assert {s for s in m.modules() if isinstance(s, Standardize)} == {m.standardize}


def test_it_makes_policies_of_its_sizes():
    m = model()
    fresh = m.new_policy(scale=0.2, learn_scale=False)
    inputs = TensorDict({"observation": torch.randn(N, S), "context": torch.randn(N, 3)}, [N])
    assert not torch.equal(fresh.get_dist(inputs).mean, m.policy.get_dist(inputs).mean)
    torch.testing.assert_close(fresh.get_dist(inputs).stddev, torch.full((N, A), 0.2))
    assert not fresh.log_scale.requires_grad
    fresh.load_state_dict(m.policy.state_dict())
    assert torch.equal(fresh.get_dist(inputs).mean, m.policy.get_dist(inputs).mean)


def test_its_trained_policy_can_be_trained_on():
    m = model()
    policy = m.trained_policy(scale=0.2, learn_scale=False)
    inputs = TensorDict({"observation": torch.randn(N, S), "context": torch.randn(N, 3)}, [N])
    assert torch.equal(policy.get_dist(inputs).mean, m.policy.get_dist(inputs).mean)
    torch.testing.assert_close(policy.get_dist(inputs).stddev, torch.full((N, A), 0.2))
    assert not policy.log_scale.requires_grad
    with torch.no_grad():
        for parameter in policy.parameters():
            parameter.add_(1.0)  # the model's own stays as it is
    assert not torch.equal(policy.get_dist(inputs).mean, m.policy.get_dist(inputs).mean)


@pytest.mark.parametrize(
    ("config", "message"),
    [
        ({"encoder": "rnn"}, "encoder\n  Input should be 'flat', 'masked' or 'attention'"),
        ({"encoder": "rnn", "context_dim": 0}, "encoder\n  Input should be"),
        ({"reward": "airl"}, "reward\n  Input should be 'shaped' or 'gail'"),
    ],
)
def test_unknown_kinds_are_refused(config, message):
    with pytest.raises(ValueError, match=message):
        model(**config)


@pytest.mark.parametrize(("name", "unit"), [("relu", nn.ReLU), ("tanh", nn.Tanh)])
def test_a_new_policy_has_the_units_that_were_asked_for(name, unit):
    policy = PEMIRLModel(2, 2, 10).new_policy(activation=name)
    units = [type(m) for m in policy.modules() if isinstance(m, nn.ReLU | nn.Tanh)]
    assert units == [unit, unit]


def test_an_unknown_unit_is_refused():
    with pytest.raises(ValueError, match=r"unknown activation 'gelu'; choose one of .*tanh"):
        PEMIRLModel(2, 2, 10).new_policy(activation="gelu")
