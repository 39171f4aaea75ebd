"""Measures of health against second ways to the same numbers."""

import math

import pytest
import torch

from pemirl_trl.functional import (
    channel_information,
    dependence_on_context,
    share_between_groups,
)


def test_information_is_that_of_a_gaussian_channel():
    """I(m; j) = H(m) - H(m | j) by Monte Carlo, with means that are themselves Gaussian."""
    generator = torch.Generator().manual_seed(0)
    signal, noise = torch.tensor([2.0, 0.5]), torch.tensor([0.5, 1.0])
    loc = signal * torch.randn(100_000, 2, generator=generator, dtype=torch.float64)
    m = loc + noise * torch.randn(100_000, 2, generator=generator, dtype=torch.float64)
    marginal = torch.distributions.Normal(0.0, (signal**2 + noise**2).sqrt())
    ratio = torch.distributions.Normal(loc, noise).log_prob(m) - marginal.log_prob(m)
    got = channel_information(loc, noise.expand_as(loc))
    assert float(got) == pytest.approx(float(ratio.sum(-1).mean()), rel=0.01)


def test_information_is_zero_where_q_is_the_same_for_all_whatever_its_kl():
    loc = torch.tensor([[3.0, -1.0]]).expand(5, 2)
    assert float(channel_information(loc, torch.full((5, 2), 0.1))) == 0.0


def test_share_is_the_intraclass_correlation():
    """By hand: group means 2 and 6 of pairs, B = 2 * 8 = 16, W = 2."""
    values = torch.tensor([[1.0, 3.0], [5.0, 7.0]])
    assert float(share_between_groups(values)) == pytest.approx((16 - 2) / (16 + 2))


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9])
def test_share_recovers_the_variance_that_was_put_in(share):
    generator = torch.Generator().manual_seed(1)
    groups = torch.randn(4000, 1, generator=generator) * math.sqrt(share)
    values = groups + torch.randn(4000, 8, generator=generator) * math.sqrt(1 - share)
    assert float(share_between_groups(values)) == pytest.approx(share, abs=0.02)


def test_share_of_a_constant_is_zero_and_of_one_group_an_error():
    assert float(share_between_groups(torch.ones(3, 4))) == 0.0
    with pytest.raises(ValueError, match=r"got \[1, 4\] values"):
        share_between_groups(torch.ones(1, 4))
    with pytest.raises(ValueError, match=r"got \[3, 1\] values"):
        share_between_groups(torch.ones(3, 1))


@pytest.mark.parametrize("weight", [0.0, 0.5, 1.0])
def test_dependence_is_the_total_index_of_m(weight):
    """r = s + weight m of independent unit normals: weight^2 / (1 + weight^2) comes from m."""
    s, m, other = torch.randn(3, 200_000, generator=torch.Generator().manual_seed(2))
    got = dependence_on_context(s + weight * m, s + weight * other)
    assert float(got) == pytest.approx(weight**2 / (1 + weight**2), abs=0.01)


def test_dependence_of_a_constant_is_zero():
    assert float(dependence_on_context(torch.ones(9), torch.ones(9))) == 0.0
