"""The discriminator's algebra, against numbers worked out by hand and the textbook forms."""

import math

import pytest
import torch

from pemirl_trl.functional import (
    binary_classification_loss,
    logit_expert,
    policy_reward,
    shaped_reward,
)

pytestmark = pytest.mark.usefixtures("float64")


def test_shaped_reward_by_hand():
    f = shaped_reward(torch.tensor(1.0), torch.tensor(2.0), torch.tensor(3.0), gamma=0.5)
    assert f == 1.0 + 0.5 * 3.0 - 2.0


def test_logit_is_that_of_the_papers_discriminator():
    f, log_prob = torch.randn(50), torch.randn(50)
    d = f.exp() / (f.exp() + log_prob.exp())
    assert torch.allclose(logit_expert(f, log_prob), d.log() - (1 - d).log())


def test_classification_loss_and_gradient_by_hand():
    # sigmoid(ln 3) = 3/4: an expert costs ln(4/3), a policy transition ln 4.
    logit = torch.full((2,), math.log(3.0), requires_grad=True)
    loss = binary_classification_loss(logit, torch.tensor([True, False]))
    assert torch.allclose(loss, torch.tensor([math.log(4 / 3), math.log(4)]))
    (gradient,) = torch.autograd.grad(loss.sum(), logit)
    assert torch.allclose(gradient, torch.tensor([-0.25, 0.75]))  # sigmoid - is_expert


def test_classification_loss_is_exact_far_out():
    logit = torch.tensor([1e4, -1e4], requires_grad=True)
    loss = binary_classification_loss(logit, torch.tensor([False, True]))
    assert torch.equal(loss, torch.tensor([1e4, 1e4]))
    (gradient,) = torch.autograd.grad(loss.sum(), logit)
    assert torch.equal(gradient, torch.tensor([1.0, -1.0]))


def test_policy_rewards():
    reward, shaped, log_prob = torch.randn(3, 7)
    assert torch.equal(policy_reward(reward, shaped, log_prob, "state"), reward)
    assert torch.equal(policy_reward(reward, shaped, log_prob, "shaped"), shaped)
    assert torch.equal(policy_reward(reward, shaped, log_prob, "score"), shaped - log_prob)
    with pytest.raises(ValueError, match=r"'gail'.*'state', 'shaped', 'score'"):
        policy_reward(reward, shaped, log_prob, "gail")
