"""The covariance of Lemma 2 on two contexts of three rollouts, by hand."""

import pytest
import torch

from pemirl_trl.functional import (
    info_encoder_loss,
    info_reward_loss,
    normalized_within_context,
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
