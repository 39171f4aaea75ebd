"""The covariance of Lemma 2 on two contexts of three rollouts, by hand."""

import math

import pytest
import torch

from pemirl_trl.functional import (
    info_encoder_loss,
    info_reward_loss,
    mixed_with_prior,
    normalized_within_context,
    tilted_info_reward_loss,
)

pytestmark = pytest.mark.usefixtures("float64")

LOG_Q = torch.tensor([[1.0, 2.0, 6.0], [0.0, 0.0, 3.0]], dtype=torch.float64)
RETURNS = torch.tensor([[2.0, 0.0, 1.0], [5.0, 1.0, 0.0]], dtype=torch.float64)


def test_covariance_by_hand():
    # Centred log q: (-2, -1, 3) and (-1, -1, 2).
    # Covariances: (-4 + 0 + 3) / 2 = -1/2 and (-5 - 1 + 0) / 2 = -3; their mean is -7/4.
    log_q, returns = LOG_Q.clone().requires_grad_(), RETURNS.clone().requires_grad_()
    loss = info_reward_loss(log_q, returns)
    assert torch.isclose(loss, torch.tensor(1.75))
    (gradient,) = torch.autograd.grad(loss, returns, retain_graph=True)
    expected = torch.tensor([[2.0, 1.0, -3.0], [1.0, 1.0, -2.0]]) / 4  # over K - 1 = 2 and M = 2
    assert torch.allclose(gradient, expected)
    assert torch.autograd.grad(loss, log_q, allow_unused=True) == (None,)


def test_normalisation_by_hand():
    # Squared deviations: 14 and 6 over 6 - 2 = 4 degrees of freedom.
    loss = info_reward_loss(LOG_Q, RETURNS, normalize=True)
    assert torch.isclose(loss, torch.tensor(1.75) / 5.0**0.5)


def test_log_q_is_centred_by_context_and_scaled_over_the_batch():
    result = normalized_within_context(LOG_Q)
    expected = torch.tensor([[-2.0, -1.0, 3.0], [-1.0, -1.0, 2.0]]) / 5.0**0.5
    assert torch.allclose(result, expected)
    assert torch.allclose(normalized_within_context(1e3 * LOG_Q - 4e4), expected)


def test_equal_log_q_say_nothing():
    constant = torch.tensor([[3.0], [-8.0]]).expand(2, 3)
    assert torch.equal(normalized_within_context(constant), torch.zeros(2, 3))
    assert info_reward_loss(constant, RETURNS, normalize=True) == 0


def test_a_constant_added_to_a_context_changes_nothing():
    offset = torch.tensor([[100.0], [-7.0]])
    loss = info_reward_loss(LOG_Q, RETURNS)
    assert torch.isclose(info_reward_loss(LOG_Q + offset, RETURNS), loss)
    assert torch.isclose(info_reward_loss(LOG_Q, RETURNS + offset), loss)


def test_the_encoder_loss_is_a_mean_log_likelihood():
    assert torch.isclose(info_encoder_loss(LOG_Q), torch.tensor(-2.0))


def test_errors_name_the_problem():
    with pytest.raises(ValueError, match=r"at least 2 rollouts per context, got 1"):
        info_reward_loss(LOG_Q[:, :1], RETURNS[:, :1])
    with pytest.raises(ValueError, match=r"at least 2 rollouts per context, got 1"):
        normalized_within_context(LOG_Q[:, :1])
    with pytest.raises(ValueError, match=r"\[contexts, rollouts\], got \(2, 3\) and \(6,\)"):
        info_reward_loss(LOG_Q, RETURNS.flatten())
    with pytest.raises(ValueError, match=r"got \(6,\) and \(6,\)"):
        info_reward_loss(LOG_Q.flatten(), RETURNS.flatten())


def test_the_tilted_loss_has_lemma_2s_slope_where_returns_are_equal():
    log_q = torch.randn(5, 4, dtype=torch.float64)
    returns = torch.full((5, 4), 1.7, dtype=torch.float64, requires_grad=True)
    (tilted,) = torch.autograd.grad(tilted_info_reward_loss(log_q, returns), returns)
    (covariance,) = torch.autograd.grad(info_reward_loss(log_q, returns), returns)
    assert torch.allclose(tilted, covariance, atol=1e-12)


@pytest.mark.parametrize(
    ("loss", "runs_away"), [(info_reward_loss, True), (tilted_info_reward_loss, False)]
)
def test_with_nothing_to_oppose_it_only_the_tilted_loss_leaves_r_finite(loss, runs_away):
    """The sampler stands still and the discriminator is saturated: log q is what it is."""
    torch.manual_seed(0)
    log_q, returns = torch.randn(6, 8), torch.zeros(6, 8, requires_grad=True)
    optimizer = torch.optim.SGD([returns], lr=10.0)
    for _ in range(2000):
        optimizer.zero_grad()
        loss(log_q, returns).backward()
        optimizer.step()
    final = returns.detach()
    spread = float((final.max(1).values - final.min(1).values).max())
    assert (spread > 1000) == runs_away
    if not runs_away:
        assert spread < 30
        assert tilted_info_reward_loss(log_q, final) >= -log_q.abs().max() * 8 / 7


def test_a_mixture_with_the_prior_is_bounded_below_and_still_a_density():
    grid = torch.linspace(-30, 30, 60_001, dtype=torch.float64)
    prior, q = torch.distributions.Normal(0.0, 1.0), torch.distributions.Normal(3.0, 0.05)
    mixed = mixed_with_prior(q.log_prob(grid), prior.log_prob(grid), 0.01)
    assert torch.trapezoid(mixed.exp(), grid) == pytest.approx(1.0, abs=1e-6)
    assert (mixed >= prior.log_prob(grid) + math.log(0.01) - 1e-12).all()
    assert torch.equal(mixed_with_prior(grid, grid, 0.0), grid)
    with pytest.raises(ValueError, match="prior_fraction is 1"):
        mixed_with_prior(grid, grid, 1)


def test_a_rollout_that_q_cannot_explain_has_no_say_in_psi():
    log_q = torch.tensor([-1.0, -7000.0], requires_grad=True)
    mixed = mixed_with_prior(log_q, torch.tensor([-3.0, -3.0]), 0.01)
    (slope,) = torch.autograd.grad(mixed.sum(), log_q)
    assert slope[0] > 0.9
    assert slope[1] == 0
