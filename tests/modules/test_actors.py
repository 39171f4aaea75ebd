"""The policy's density, its deviation, and a value that knows the time."""

import math

import pytest
import torch
from tensordict import TensorDict
from torch.distributions import Normal
from torchrl.envs.utils import ExplorationType, set_exploration_type

from pemirl_trl.modules import (
    AIRLDiscriminator,
    ContextPolicy,
    ContextValue,
    ShapedReward,
    Standardize,
)
from pemirl_trl.objectives import DiscriminatorLoss, TRPOLoss

N, T, S, A, D = 5, 4, 3, 2, 2


def batch():
    return TensorDict(
        {"observation": torch.randn(N, T, S), "context": torch.randn(N, T, D)}, [N, T]
    )


def test_the_stored_density_is_that_of_the_action_drawn():
    policy = ContextPolicy(S, A, D, initial_scale=0.5)
    with set_exploration_type(ExplorationType.RANDOM):
        result = policy(batch())
    assert torch.allclose(result["scale"], torch.tensor(0.5))
    density = Normal(result["loc"], result["scale"]).log_prob(result["action"]).sum(-1)
    assert torch.allclose(result["action_log_prob"], density)
    assert result["action_log_prob"].shape == (N, T)
    noise = (result["action"] - result["loc"]) / 0.5
    assert 0.7 < noise.std() < 1.3


def test_without_exploration_the_action_is_the_mean():
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        result = ContextPolicy(S, A, D)(batch())
    assert torch.equal(result["action"], result["loc"])


def test_get_dist_has_a_density_for_each_step_and_torchs_entropy():
    policy = ContextPolicy(S, A, D, initial_scale=0.5)
    distribution = policy.get_dist(batch())
    assert (distribution.batch_shape, distribution.event_shape) == ((N, T), (A,))
    entropy = A * (0.5 * math.log(2 * math.pi * math.e) + math.log(0.5))
    assert torch.allclose(distribution.entropy(), torch.tensor(entropy))


@pytest.mark.parametrize("key", ["observation", "context"])
def test_the_mean_reads_state_and_context(key):
    policy, b = ContextPolicy(S, A, D), batch()
    loc = policy(b.copy())["loc"]
    b[key] = b[key] + 1.0
    assert (policy(b)["loc"] - loc).abs().max() > 1e-3


def test_an_expert_reads_its_task_in_place_of_a_context():
    policy = ContextPolicy(S, A, D, context_key=("task", "goal"))
    plain, b = ContextPolicy(S, A, D), batch()
    plain.load_state_dict(policy.state_dict())
    expected = plain(b.copy())["loc"]
    assert torch.equal(policy(b.rename_key_("context", ("task", "goal")))["loc"], expected)


@pytest.mark.parametrize("learn", [True, False])
def test_a_held_deviation_is_not_learned_but_can_be_set(learn):
    policy = ContextPolicy(S, A, D, learn_scale=learn)
    policy.get_dist(batch()).log_prob(torch.zeros(N, T, A)).sum().backward()
    assert (policy.log_scale.grad is not None) == learn
    assert all(p.grad.any() for p in policy.parameters() if p is not policy.log_scale)
    policy.log_scale.data.fill_(math.log(0.2))
    assert torch.allclose(policy(batch())["scale"], torch.tensor(0.2))


def test_the_value_knows_the_time():
    value = ContextValue(S, D, horizon=T)
    same = TensorDict({"observation": torch.zeros(1, T, S), "context": torch.zeros(1, T, D)}, [1])
    values = value(same)["state_value"]
    assert values.shape == (1, T, 1)
    assert len(values.unique()) == T
    first = value(same.apply(lambda x: x[:, :2]))["state_value"]
    assert torch.allclose(first, values[:, :2])


def test_a_map_of_contexts_is_applied_to_them_alone():
    context = 5.0 + 0.01 * torch.randn(200, 2)
    mapped = ContextPolicy(3, 1, 2, standardize_context=Standardize.fit(context))
    plain = ContextPolicy(3, 1, 2)
    plain.gaussian.net.load_state_dict(mapped.gaussian.net.state_dict())
    data = TensorDict({"observation": torch.randn(200, 3), "context": context}, [200])
    z = data.clone().set("context", (context - context.mean(0)) / context.std(0))
    torch.testing.assert_close(mapped.get_dist(data).mean, plain.get_dist(z).mean)
    assert "module.0.net.standardize_context.loc" in dict(mapped.named_buffers())
    assert not any("standardize_context" in name for name, _ in plain.named_buffers())


def test_one_context_serves_many_observations():
    policy, observation, context = ContextPolicy(S, A, D), torch.randn(N, S), torch.randn(1, D)
    expected = policy.gaussian(observation, context.expand(N, D))
    for got, value in zip(policy.gaussian(observation, context), expected, strict=True):
        assert torch.equal(got, value)


def test_the_key_of_the_density_is_set_once_and_followed():
    policy = ContextPolicy(S, A, D, log_prob_key="log_pi")
    reward = ShapedReward(S, D)
    discriminator = AIRLDiscriminator(reward, log_prob_key=policy.log_prob_key)
    rollouts = policy(batch())
    assert "log_pi" in rollouts
    assert "action_log_prob" not in rollouts
    for loss in (TRPOLoss(policy), DiscriminatorLoss(discriminator)):
        assert loss.tensor_keys.action_log_prob == "log_pi"
        assert "log_pi" in loss.in_keys


def test_a_value_refuses_rollouts_that_have_lost_their_time():
    with pytest.raises(ValueError, match=r"got observations \[20, 3\].*do not flatten N and T"):
        ContextValue(S, D, T)(batch().reshape(-1))


def test_a_value_can_be_called_by_keywords():
    value, inputs = ContextValue(S, D, T), batch()
    assert torch.equal(value(**inputs), value(inputs)["state_value"])
