"""L_info(theta, psi) = sum_m p(m) sum_tau p_theta(tau|m) log q_psi(m|tau), summed exactly.

Automatic differentiation of this sum is the truth; the expected gradient of each loss, under the
exact p_theta(tau|m), must be minus it (Lemma 2 and Equation 7 of Yu et al., 2019).
"""

import itertools

import pytest
import torch
from torch import nn

from pemirl_trl.functional import info_reward_loss
from pemirl_trl.modules import ContextEncoder, ShapedReward
from pemirl_trl.objectives import InfoLoss

from .finite_mdp import FiniteMDP

pytestmark = pytest.mark.usefixtures("float64")


@pytest.fixture
def problem(float64):
    torch.manual_seed(3)
    mdp = FiniteMDP.random()
    # Rewards of order one: under p_theta the trajectories are neither equal nor one alone.
    reward = ShapedReward(3, 2, gamma=0.9, hidden=(6,), activation=nn.Tanh)
    encoder = ContextEncoder(
        3, 1, 2, mdp.horizon, hidden=(6,), activation=nn.Tanh, scale_depends_on_input=True
    )
    with torch.no_grad():
        for parameter in (*reward.parameters(), *encoder.parameters()):
            parameter.add_(0.3 * torch.randn_like(parameter))
    return mdp, reward, encoder


def flat_gradient(scalar, module):
    grads = torch.autograd.grad(scalar, list(module.parameters()), retain_graph=True)
    return torch.cat([g.flatten() for g in grads])


def relative_error(got, expected):
    return ((got - expected).norm() / expected.norm()).item()


def information(mdp, reward, encoder):
    probability = mdp.trajectory_probability(mdp.shaped(reward))
    return (mdp.prior.unsqueeze(-1) * probability * mdp.log_q(encoder)).sum()


def uncentred(log_q, returns):
    """The covariance without its centring: E[xy] alone."""
    return -(log_q.detach() * returns).mean()


def divided_by_k(log_q, returns):
    """The biased sample covariance."""
    k = log_q.shape[1]
    return info_reward_loss(log_q, returns) * (k - 1) / k


def expected_loss(mdp, reward, encoder, rollouts, loss):
    """The loss of every tuple of trajectories, weighted by its probability under p_theta."""
    shaped = mdp.shaped(reward)
    returns, log_q = mdp.returns(shaped), mdp.log_q(encoder)
    probability = mdp.trajectory_probability(shaped).detach()
    tuples = torch.tensor(list(itertools.product(range(returns.shape[1]), repeat=rollouts)))
    weight = mdp.prior.unsqueeze(-1) * probability[:, tuples].prod(-1)  # [M, tuples]
    each = torch.vmap(lambda q, r: loss(q.unsqueeze(0), r.unsqueeze(0)))
    losses = each(log_q[:, tuples].flatten(0, 1), returns[:, tuples].flatten(0, 1))
    return (weight.flatten() * losses).sum()


@pytest.mark.parametrize("rollouts", [2, 3])
def test_the_function_gives_lemma_2(problem, rollouts):
    mdp, reward, encoder = problem
    truth = flat_gradient(information(*problem), reward)
    assert truth.norm() > 0.01
    loss = expected_loss(mdp, reward, encoder, rollouts, info_reward_loss)
    assert relative_error(-flat_gradient(loss, reward), truth) < 1e-5


@pytest.mark.parametrize("wrong", [uncentred, divided_by_k])
def test_the_oracle_rejects_a_biased_estimator(problem, wrong):
    mdp, reward, encoder = problem
    truth = flat_gradient(information(*problem), reward)
    loss = expected_loss(mdp, reward, encoder, 2, wrong)
    assert relative_error(-flat_gradient(loss, reward), truth) > 0.1


def test_the_loss_class_gives_both_gradients(problem):
    mdp, reward, encoder = problem
    loss = InfoLoss(encoder, reward, rollouts_per_context=2)
    probability = mdp.trajectory_probability(mdp.shaped(reward)).detach()
    trajectories = range(probability.shape[1])
    expected = {"loss_info_encoder": 0.0, "loss_info_reward": 0.0}
    for m, i, j in itertools.product(range(len(mdp.contexts)), trajectories, trajectories):
        batch = mdp.rollouts(torch.tensor([i, j]), mdp.contexts[m].expand(2, -1))
        losses = loss(batch)
        for key in expected:
            weight = mdp.prior[m] * probability[m, i] * probability[m, j]
            expected[key] = expected[key] + weight * losses[key]
    truth = information(*problem)
    for key, module in (("loss_info_encoder", encoder), ("loss_info_reward", reward)):
        got = -flat_gradient(expected[key], module)
        assert relative_error(got, flat_gradient(truth, module)) < 1e-5
    assert torch.isclose(-expected["loss_info_encoder"], truth)


def test_state_summand_and_time_mean_are_what_they_say(problem):
    mdp, reward, encoder = problem
    batch = mdp.rollouts(torch.tensor([0, 3, 5, 6]), mdp.contexts.repeat_interleave(2, 0))

    def gradient(module, **kwargs):
        loss = InfoLoss(encoder, reward, rollouts_per_context=2, **kwargs)
        return flat_gradient(loss(batch)["loss_info_reward"], module)

    paper = gradient(reward.reward_net)
    assert torch.allclose(gradient(reward.reward_net, summand="state"), paper)
    assert torch.allclose(mdp.horizon * gradient(reward.reward_net, time_mean=True), paper)
    normalised = gradient(reward, normalize=True)
    ratio = gradient(reward).norm() / normalised.norm()
    assert abs(ratio - 1) > 0.1
    assert torch.allclose(ratio * normalised, gradient(reward))


def z_score(problem, loss, draws=4000, rollouts=4):
    """Of the Monte-Carlo mean, along the true gradient, against the truth."""
    mdp, reward, encoder = problem
    truth = flat_gradient(information(*problem), reward)
    direction = truth / truth.norm()
    shaped = mdp.shaped(reward)
    returns, log_q = mdp.returns(shaped), mdp.log_q(encoder).detach()
    slope = torch.stack(  # of each trajectory's return along the true gradient
        [flat_gradient(r, reward) @ direction for r in returns.flatten()]
    ).view_as(returns)
    probability = mdp.trajectory_probability(shaped).detach()
    m = mdp.prior.multinomial(draws, replacement=True)
    drawn = probability[m].multinomial(rollouts, replacement=True)
    m = m.unsqueeze(-1)
    per_return = torch.func.grad(lambda r, q: loss(q.unsqueeze(0), r.unsqueeze(0)))
    weights = torch.vmap(per_return)(returns[m, drawn], log_q[m, drawn])
    estimates = -(weights * slope[m, drawn]).sum(-1).detach()
    return ((estimates.mean() - truth.norm()) / (estimates.std() / draws**0.5)).item()


def test_the_estimate_of_four_rollouts_is_unbiased(problem):
    assert abs(z_score(problem, info_reward_loss)) < 3.0


def test_the_z_test_rejects_division_by_k(problem):
    assert z_score(problem, divided_by_k) < -5.0
