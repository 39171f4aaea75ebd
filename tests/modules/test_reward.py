"""The shaped reward and the discriminator on top of it are what their equations say."""

import pytest
import torch
from tensordict import TensorDict

from pemirl_trl.modules import AIRLDiscriminator, GAILDiscriminator, ShapedReward, Standardize

N, S, D = 7, 3, 2


def batch():
    return TensorDict(
        {
            "observation": torch.randn(N, S),
            "next": {"observation": torch.randn(N, S)},
            "context": torch.randn(N, D),
            "action_log_prob": torch.randn(N),
        },
        [N],
    )


def test_the_shaped_reward_and_the_logit(float64):
    reward = ShapedReward(S, D, gamma=0.7, standardize=Standardize(torch.randn(S), torch.ones(S)))
    b = batch()
    result = AIRLDiscriminator(reward)(b.copy())
    s, following, m = b["observation"], b["next", "observation"], b["context"]
    shaping = 0.7 * reward.potential(following, m) - reward.potential(s, m)
    assert torch.allclose(result["learned_reward"], reward.reward(s, m))
    assert torch.allclose(result["shaped_reward"], reward.reward(s, m) + shaping)
    expected = result["shaped_reward"].squeeze(-1) - b["action_log_prob"]
    assert torch.allclose(result["logit_expert"].squeeze(-1), expected)


def test_reward_and_potential_are_two_networks_and_the_reward_reads_the_state_alone():
    reward = ShapedReward(S, D)
    b, other = batch(), batch()
    r = reward(b.copy())["learned_reward"]
    b["next", "observation"] = other["next", "observation"]
    with torch.no_grad():
        for parameter in reward.potential_net.parameters():
            parameter.add_(1.0)
    assert torch.equal(reward(b.copy())["learned_reward"], r)
    b["context"] = other["context"]
    assert not torch.equal(reward(b)["learned_reward"], r)


def test_without_a_next_observation_there_is_r_and_no_f():
    reward, b = ShapedReward(S, D), batch()
    expected = reward(b.copy())["learned_reward"]
    result = reward(b.select("observation", "context"))
    assert torch.equal(result["learned_reward"], expected)
    assert set(result.keys()) == {"observation", "context", "learned_reward"}


def test_a_discriminator_shares_its_reward():
    reward = ShapedReward(S, D)
    discriminator = AIRLDiscriminator(reward)
    assert {id(p) for p in discriminator.parameters()} == {id(p) for p in reward.parameters()}


def test_keys_can_be_nested(float64):
    reward = ShapedReward(S, D, context_key=("latent", "m"))
    discriminator = AIRLDiscriminator(reward, log_prob_key=("old", "log_prob"))
    b = batch()
    plain = ShapedReward(S, D)
    plain.load_state_dict(reward.state_dict())
    expected = AIRLDiscriminator(plain)(b.copy())["logit_expert"]
    b.rename_key_("context", ("latent", "m")).rename_key_("action_log_prob", ("old", "log_prob"))
    assert torch.equal(discriminator(b)["logit_expert"], expected)


def test_a_reward_of_some_features_ignores_the_others_and_its_potential_does_not():
    reward = ShapedReward(4, 2, reward_features=[3, 1])
    state, m = torch.randn(6, 4, requires_grad=True), torch.randn(6, 2)
    (of_r,) = torch.autograd.grad(reward.reward(state, m).sum(), state)
    assert torch.equal(of_r[:, [0, 2]], torch.zeros(6, 2))
    assert (of_r[:, [1, 3]] != 0).any(0).all()
    (of_h,) = torch.autograd.grad(reward.potential(state, m).sum(), state)
    assert (of_h != 0).any(0).all()
    torch.testing.assert_close(
        reward.reward(state, m), reward.reward_net(state[:, [3, 1]], m), rtol=0.0, atol=0.0
    )


@pytest.mark.parametrize("features", [[], [0, 0], [4], [-1]])
def test_features_that_are_none_of_an_observation_are_refused(features):
    with pytest.raises(ValueError, match="expected distinct numbers from 0 to 3"):
        ShapedReward(4, 2, reward_features=features)


def test_one_context_serves_many_observations():
    reward, observation, context = ShapedReward(S, D), torch.randn(5, S), torch.randn(1, D)
    for function in (reward.reward, reward.potential):
        expected = function(observation, context.expand(5, D))
        assert torch.equal(function(observation, context), expected)
        assert torch.equal(function(observation, context[0]), expected)


def test_a_discriminator_needs_a_reward_with_a_potential():
    with pytest.raises(TypeError, match=r"takes a shaped reward .*got GAILDiscriminator"):
        AIRLDiscriminator(GAILDiscriminator(S, 1))


def test_a_discriminator_without_a_next_observation_has_no_logit():
    discriminator = AIRLDiscriminator(ShapedReward(S, D))
    batch = TensorDict(
        {
            "observation": torch.randn(4, S),
            "context": torch.randn(4, D),
            "action_log_prob": torch.randn(4),
        },
        [4],
    )
    with pytest.raises(KeyError, match=r"AIRLDiscriminator reads \('next', 'observation'\)"):
        discriminator(batch)


def along_a_rollout():
    states, m = torch.randn(N, 6, S), torch.randn(N, 1, D)
    return TensorDict(
        {
            "observation": states[:, :-1],
            "next": {"observation": states[:, 1:]},
            "context": m.expand(N, 5, D),
        },
        [N, 5],
    )


@pytest.mark.parametrize("broken", [None, "state", "context"])
def test_along_rollouts_the_potential_of_each_state_is_asked_once(broken, float64):
    reward, b, rows = ShapedReward(S, D), along_a_rollout().clone(), []
    if broken == "state":
        b["next", "observation"][3, 2] += 1.0
    elif broken == "context":
        b["context"][3, 2] += 1.0
    reward.potential_net.register_forward_pre_hook(lambda _, given: rows.append(given[0].shape[1]))
    result = reward(b.copy())
    assert rows == ([6] if broken is None else [5, 5])
    flat = reward(b.reshape(-1))
    torch.testing.assert_close(result["shaped_reward"].flatten(0, 1), flat["shaped_reward"])
    weights = list(reward.parameters())
    for ours, theirs in zip(
        torch.autograd.grad(result["shaped_reward"].square().sum(), weights),
        torch.autograd.grad(flat["shaped_reward"].square().sum(), weights),
        strict=True,
    ):
        torch.testing.assert_close(ours, theirs)


def test_along_rollouts_states_keep_their_gradients():
    b = along_a_rollout().clone()
    following = b["next", "observation"].requires_grad_()
    ShapedReward(S, D)(b)["shaped_reward"].sum().backward()
    assert following.grad.abs().sum() > 0
