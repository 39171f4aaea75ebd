"""The closed form of the KL against torch's, and against an integral."""

import torch
from torch.distributions import Normal, kl_divergence

from pemirl_trl.functional import kl_to_standard_normal


def test_kl_equals_torchs(float64):
    loc, scale = torch.randn(20, 3), torch.rand(20, 3) + 0.1
    expected = kl_divergence(Normal(loc, scale), Normal(0.0, 1.0)).sum(-1)
    assert torch.allclose(kl_to_standard_normal(loc, scale), expected)


def test_kl_equals_the_integral(float64):
    loc, scale = torch.tensor([0.7]), torch.tensor([0.4])
    x = torch.linspace(-4.0, 5.0, 4001)
    p, q = Normal(loc, scale), Normal(0.0, 1.0)
    integral = torch.trapezoid(p.log_prob(x).exp() * (p.log_prob(x) - q.log_prob(x)), x)
    assert torch.allclose(kl_to_standard_normal(loc, scale), integral, rtol=1e-9)
    assert kl_to_standard_normal(torch.zeros(3), torch.ones(3)) == 0
