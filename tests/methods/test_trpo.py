"""The trust-region step on collected rollouts."""

import copy
import math

import pytest
import torch
from torch.distributions import Normal, kl_divergence

from pemirl_trl.methods import TRPO, EpisodeCollector, TRPOConfig


def collected(problem, config=None, contexts=4):
    model = problem.model()
    rollouts = EpisodeCollector(problem.env(model, contexts, 4), model.policy, problem.horizon)()
    return model, rollouts, TRPO(model.policy, config or TRPOConfig(), 4)


def gaussian(policy, rollouts):
    loc = policy.gaussian.net(
        policy.gaussian.standardize(rollouts["observation"]), rollouts["context"]
    )
    return Normal(loc, policy.log_scale.exp())


def test_the_divergence_is_zero_before_a_step(maze):
    # The authors' code measures up to 10 nats here, against a bound of 0.01.
    _, rollouts, step = collected(maze)
    assert step.loss(step.advantage(rollouts))["kl"].detach() == 0.0


@pytest.mark.parametrize("max_kl", [1e-3, 5e-2])
def test_a_step_uses_its_trust_region_and_stays_inside(max_kl, maze):
    model, rollouts, step = collected(maze, TRPOConfig(max_kl=max_kl))
    old = copy.deepcopy(model.policy)
    metrics = step(rollouts)
    with torch.no_grad():
        kl = kl_divergence(gaussian(old, rollouts), gaussian(model.policy, rollouts)).sum(-1).mean()
    assert metrics["trpo/accepted"] == 1.0
    assert 0.3 * max_kl < kl <= max_kl * (1 + 1e-5)
    assert metrics["trpo/kl"] == pytest.approx(float(kl), rel=1e-3)
    assert metrics["trpo/improvement"] > 0.0


def test_a_step_raises_the_probability_of_good_actions(reach):
    model, rollouts, step = collected(reach, contexts=50)
    rollouts["next", "reward"] = rollouts["action"].clone()  # the more to the right, the better
    before = gaussian(model.policy, rollouts).loc.mean()
    step(rollouts)
    assert gaussian(model.policy, rollouts).loc.mean() > before + 0.05


def test_advantages_are_standardised_over_what_the_configuration_says(reach):
    for group in ("batch", "context"):
        _, rollouts, step = collected(reach, TRPOConfig(standardize=group))
        rollouts["next", "reward"][:4] *= 100.0  # the four rollouts of the first context
        advantage = step.advantage(rollouts)["advantage"].view(4, -1)
        deviation = advantage.square().mean(1).sqrt()
        assert bool((deviation[0] > 10 * deviation[1:]).all()) == (group == "batch")


def test_the_extra_loss_is_inside_the_trust_region(reach):
    model, rollouts, step = collected(reach)
    rollouts["next", "reward"] = torch.zeros_like(rollouts["next", "reward"])
    before = gaussian(model.policy, rollouts).loc.mean().detach()

    def to_the_right():
        return -gaussian(model.policy, rollouts).loc.mean()

    metrics = step(rollouts, to_the_right)
    assert gaussian(model.policy, rollouts).loc.mean() > before + 0.05
    assert metrics["trpo/kl"] <= step.config.max_kl


def test_a_gradient_that_is_not_finite_changes_nothing_and_shows(reach):
    model, rollouts, step = collected(reach)
    before = copy.deepcopy(model.policy.state_dict())
    metrics = step(rollouts, lambda: model.policy.log_scale.sum() * math.nan)
    assert math.isnan(metrics["trpo/gradient_norm"])  # by which the training loop stops
    assert metrics["trpo/accepted"] == 0.0
    assert all(torch.equal(v, before[k]) for k, v in model.policy.state_dict().items())
