"""Returns, standardisation and the surrogate, by hand and against finite differences."""

import pytest
import torch

from pemirl_trl.functional import discounted_return, standardize, surrogate

pytestmark = pytest.mark.usefixtures("float64")


def test_discounted_return_by_hand():
    reward = torch.tensor([[1.0, 2.0, 4.0], [0.0, 0.0, 8.0]])
    expected = torch.tensor([[3.0, 4.0, 4.0], [2.0, 4.0, 8.0]])  # nothing lies beyond the end
    assert torch.equal(discounted_return(reward, gamma=0.5), expected)


def test_discounted_return_is_a_sum_over_the_future():
    reward, gamma = torch.randn(2, 3, 9), 0.9
    t = torch.arange(9)
    weights = torch.triu(gamma ** (t - t.unsqueeze(-1)).double())  # [t, k]: gamma^(k - t)
    assert torch.allclose(discounted_return(reward, gamma), reward @ weights.T)


def test_standardize():
    values = 5.0 + 3.0 * torch.randn(4, 50)
    result = standardize(values)
    assert result.mean().abs() < 1e-9
    assert torch.isclose(result.square().mean(), torch.tensor(1.0))
    assert torch.allclose(values, values.mean() + values.std(correction=0) * result)
    assert torch.equal(standardize(torch.full((6,), 2.0)), torch.zeros(6))


def test_surrogate_weighs_advantages_by_the_ratio():
    new, old, advantage = torch.tensor([0.2, 0.5]), torch.tensor([0.4, 0.5]), torch.tensor([3, -2])
    expected = torch.tensor([1.5, -2.0])
    assert torch.allclose(surrogate(new.log(), old.log(), advantage), expected)


def test_the_surrogates_gradient_is_the_policy_gradient():
    """grad sum_a pi(a) A(a), from the surrogate weighted by the old probabilities."""
    logits, advantage = torch.randn(5, requires_grad=True), torch.randn(5)
    (truth,) = torch.autograd.grad((logits.softmax(0) * advantage).sum(), logits)
    old = logits.log_softmax(0).detach()
    expectation = (old.exp() * surrogate(logits.log_softmax(0), old, advantage)).sum()
    assert torch.allclose(torch.autograd.grad(expectation, logits)[0], truth)
