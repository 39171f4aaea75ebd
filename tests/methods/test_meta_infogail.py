"""Meta-InfoGAIL: what the policy maximises, and what moves the posterior."""

import copy
import math

import pytest
import torch
from tensordict import TensorDict
from torch.optim import Adam

COEFF = 0.3


def weights(module):
    return {name: value.clone() for name, value in module.state_dict().items()}


def test_the_reward_is_the_logit_and_at_the_last_step_the_information(reach):
    method = reach.meta_infogail(info_coeff=COEFF, contexts=3, rollouts_per_context=4)
    model, rollouts = method.model, method.sampler.collect()[0]
    reward = method._reward(rollouts).detach()
    logit = model.reward.net(
        model.standardize(rollouts["observation"]), rollouts["action"]
    ).detach()
    torch.testing.assert_close(reward[:, :-1], logit[:, :-1])
    bonus = (reward - logit)[:, -1, 0].view(3, 4)
    torch.testing.assert_close(bonus.mean(1), torch.zeros(3), atol=1e-5, rtol=0)

    trajectories = rollouts.select("observation", "action")
    trajectories.batch_size = [12]
    q = model.encoder.get_dist(trajectories)
    m = rollouts["context"][:, 0]
    log_q = torch.distributions.Normal(q.mean, q.stddev).log_prob(m).sum(-1).detach()
    centred = log_q.view(3, 4) - log_q.view(3, 4).mean(1, keepdim=True)
    deviation = math.sqrt(float(centred.square().sum()) / (12 - 3))
    expected = reach.horizon * COEFF * centred / deviation
    torch.testing.assert_close(bonus, expected, atol=1e-4, rtol=1e-4)


def test_without_a_weight_the_information_is_no_reward(reach):
    method = reach.meta_infogail(info_coeff=0.0)
    rollouts = method.sampler.collect()[0]
    scored = method.model.reward(rollouts.select("observation", "action"))
    assert torch.equal(method._reward(rollouts), scored["learned_reward"])


def test_psi_ascends_log_q_of_the_rollouts_under_their_own_contexts(reach):
    """One Adam step, repeated by hand on what the first iteration collected."""
    method = reach.meta_infogail(discriminator_steps=1, encoder_lr=0.01)
    encoder = copy.deepcopy(method.model.encoder)
    torch.manual_seed(3)
    metrics = method.iteration()
    stored = {key: value[0][::2] for key, value in method.sampler.negatives.state_dict().items()}
    trajectories = {key: stored[key] for key in ("observation", "action")}
    log_q = encoder.get_dist(TensorDict(trajectories, [4])).log_prob(stored["context"][:, 0])
    assert metrics["info/log_q"] == pytest.approx(float(log_q.detach().mean()), rel=1e-5)
    optimizer = Adam(encoder.parameters(), lr=0.01)
    (-log_q.mean()).backward()
    optimizer.step()
    torch.testing.assert_close(
        dict(method.model.encoder.state_dict()), dict(encoder.state_dict()), atol=1e-4, rtol=0
    )


def test_psi_moves_by_the_information_loss_alone(reach, differences):
    def encoder_after(other_discriminator=False, **config):
        model = reach.model(reward="gail")
        if other_discriminator:
            model.reward.load_state_dict(reach.model(seed=1, reward="gail").reward.state_dict())
        torch.manual_seed(3)
        reach.meta_infogail(model=model, **config).iteration()
        return weights(model.encoder)

    assert differences(encoder_after(), encoder_after(other_discriminator=True)) == []
    assert differences(encoder_after(), encoder_after(info_coeff=5.0)) == []


def test_the_discriminator_learns_to_tell_the_expert(reach):
    method = reach.meta_infogail(discriminator_steps=60, discriminator_lr=0.01)
    torch.manual_seed(3)
    first, *_, last = (method.iteration() for _ in range(3))
    assert last["discriminator/logit_expert_mean"] > last["discriminator/logit_policy_mean"] + 1.0
    assert last["discriminator/loss_discriminator"] < first["discriminator/loss_discriminator"]


def test_a_reward_that_is_no_discriminator_is_refused(reach):
    with pytest.raises(ValueError, match=r"contexts and reward=.gail., got .*'shaped'"):
        reach.meta_infogail(model=reach.model())


def test_a_single_rollout_per_context_is_refused(reach):
    with pytest.raises(ValueError, match="at least 2 rollouts per context, got 1"):
        reach.meta_infogail(rollouts_per_context=1).iteration()
