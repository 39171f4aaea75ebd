"""The mixture of a softmax with the uniform distribution."""

import pytest
import torch
from torch.autograd import gradcheck, gradgradcheck

from pemirl_trl.functional import mixed_with_uniform


@pytest.mark.parametrize("share", [1e-6, 0.1, 0.9])
def test_it_is_the_mixture_of_probabilities(float64, share):
    logits = 3 * torch.randn(7, 5)
    expected = (1 - share) * torch.softmax(logits, -1) + share / 5
    log_prob = mixed_with_uniform(logits, torch.tensor([share]).log())
    torch.testing.assert_close(log_prob.exp(), expected)
    torch.testing.assert_close(log_prob.exp().sum(-1), torch.ones(7))


def test_no_probability_is_below_the_floor_and_second_derivatives_stay_finite():
    """Of logits as far apart as a sure policy's: there a trust region needs the curvature."""
    logits = torch.tensor([500.0, 0.0, -500.0], requires_grad=True)
    log_prob = mixed_with_uniform(logits, torch.tensor([0.03]).log())
    torch.testing.assert_close(log_prob[1:].detach().exp(), torch.full((2,), 0.01))
    (gradient,) = torch.autograd.grad((log_prob * torch.randn(3)).sum(), logits, create_graph=True)
    (curvature,) = torch.autograd.grad((gradient * torch.randn(3)).sum(), logits)
    assert torch.isfinite(gradient).all()
    assert torch.isfinite(curvature).all()


def test_derivatives_are_those_of_finite_differences(float64):
    logits = torch.randn(3, 4, requires_grad=True)
    log_share = torch.tensor([0.2]).log()
    assert gradcheck(lambda x: mixed_with_uniform(x, log_share), logits)
    assert gradgradcheck(lambda x: mixed_with_uniform(x, log_share), logits)
