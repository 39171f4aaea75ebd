"""The Fisher information's products in closed form, against a KL that autograd differentiates."""

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torch.nn.utils import parameters_to_vector

from pemirl_trl.methods.fisher import gaussian_fisher_product, has_closed_form
from pemirl_trl.modules import ContextPolicy, Standardize
from pemirl_trl.objectives import TRPOLoss
from pemirl_trl.optim import TrustRegionOptimizer


def policy_and_batch(rows, dtype, **options):
    standardize = Standardize(torch.tensor([1.0, -2.0]), torch.tensor([0.5, 3.0]))
    policy = ContextPolicy(2, 2, 3, standardize=standardize, initial_scale=0.37, **options).to(
        dtype
    )
    values = {"observation": torch.randn(rows, 2), "context": torch.randn(rows, 3)}
    batch = TensorDict({key: value.to(dtype) for key, value in values.items()}, [rows])
    with torch.no_grad():
        batch = policy(batch)
    return policy, batch.set("advantage", torch.zeros(rows, 1, dtype=dtype))


def differentiated_twice(policy, batch):
    optimizer = TrustRegionOptimizer(policy.parameters())
    return optimizer._fisher_product(TRPOLoss(policy)(batch)["kl"])


@pytest.mark.parametrize("learn_scale", [True, False])
@pytest.mark.parametrize("options", [{}, {"activation": nn.Tanh}, {"hidden": (8,)}])
def test_the_products_are_those_of_the_hessian(options, learn_scale):
    policy, batch = policy_and_batch(50, torch.float64, learn_scale=learn_scale, **options)
    ours, expected = gaussian_fisher_product(policy, batch), differentiated_twice(policy, batch)
    size = len(parameters_to_vector(p for p in policy.parameters() if p.requires_grad))
    for _ in range(3):
        vector = torch.randn(size, dtype=torch.float64)
        assert (ours(vector) - expected(vector)).abs().max() < 1e-10


def test_in_single_precision_they_are_the_same_bits_where_the_deviation_is_held():
    # The order of the operations is autograd's, so that published runs are repeated.
    policy, batch = policy_and_batch(4000, torch.float32, learn_scale=False)
    ours, expected = gaussian_fisher_product(policy, batch), differentiated_twice(policy, batch)
    size = len(parameters_to_vector(p for p in policy.parameters() if p.requires_grad))
    vector = torch.randn(size)
    assert torch.equal(ours(vector), expected(vector))


def test_in_single_precision_they_are_the_same_up_to_rounding_where_it_is_trained():
    policy, batch = policy_and_batch(4000, torch.float32)
    ours, expected = gaussian_fisher_product(policy, batch), differentiated_twice(policy, batch)
    vector = torch.randn(len(parameters_to_vector(policy.parameters())))
    torch.testing.assert_close(ours(vector), expected(vector), rtol=1e-4, atol=1e-5)


def test_the_form_is_used_where_it_holds():
    assert has_closed_form(ContextPolicy(2, 2, 3, learn_scale=False))
    assert has_closed_form(ContextPolicy(2, 2, 3))
    assert not has_closed_form(ContextPolicy(2, 2, 3, learn_scale=False, activation=nn.SiLU))
    frozen = ContextPolicy(2, 2, 3, learn_scale=False)
    frozen.gaussian.net[0].weight.requires_grad_(False)
    assert not has_closed_form(frozen)
