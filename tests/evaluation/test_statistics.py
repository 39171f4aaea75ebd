"""SciPy, arithmetic by hand and coverage are the oracles."""

import math

import numpy as np
import pytest
import torch
from scipy import stats

from pemirl_trl.evaluation.statistics import (
    Interval,
    iqm,
    iqm_interval,
    pearson,
    probability_of_improvement,
    seeds_interval,
    spearman,
    t_interval,
)


@pytest.mark.parametrize("n", [2, 3, 10])
@pytest.mark.parametrize("confidence", [0.5, 0.95])
def test_t_interval_equals_scipy(n, confidence):
    values = torch.randn(n, dtype=torch.float64) * 3 - 7
    interval = t_interval(values, confidence)
    sem = stats.sem(values.numpy())
    expected = stats.t.interval(confidence, n - 1, loc=values.mean().item(), scale=sem)
    assert interval.estimate == pytest.approx(values.mean().item())
    assert (interval.low, interval.high) == pytest.approx(expected, rel=1e-9)


def test_t_interval_of_three_seeds_by_hand():
    # s = 1, t(0.975, 2) = 4.302653
    assert t_interval([1.0, 2.0, 3.0]) == pytest.approx((2, 2 - 2.484138, 2 + 2.484138), abs=1e-6)


def test_interquartile_mean_by_hand():
    assert iqm([100.0, 1.0, 2.0, -50.0]) == 1.5
    assert iqm([9.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 1000.0]) == (2 + 3 + 4 + 5) / 4
    assert iqm([1.0, 2.0, 6.0]) == 3  # a quarter of three values is none


def test_the_interval_is_that_of_the_pooled_values():
    strata = [[0.0, 1.0, 2.0, 3.0], [10.0, 11.0]]
    assert iqm_interval(strata, resamples=100).estimate == iqm([0, 1, 2, 3, 10, 11])
    assert iqm_interval([strata[0]]) == iqm_interval(strata[0]) == iqm_interval(tuple(strata[0]))


def test_values_are_resampled_within_their_stratum():
    """Constant strata have nothing to resample; the same values in one stratum do."""
    strata = [[0.0] * 6, [10.0] * 6]
    assert iqm_interval(strata) == Interval(5, 5, 5)
    pooled = iqm_interval([v for stratum in strata for v in stratum])
    assert pooled.low < 2
    assert pooled.high > 8


def test_interval_of_the_iqm_covers_it():
    """Of 200 samples of 20 normal values, about 95 % have the true 0 in their interval."""
    generator = np.random.default_rng(0)
    intervals = [iqm_interval(v, resamples=400) for v in generator.normal(size=(200, 20))]
    covered = np.mean([i.low <= 0 <= i.high for i in intervals])
    assert 0.87 <= covered <= 0.98  # the percentile bootstrap covers a little less than it says
    assert all(i.low < i.estimate < i.high for i in intervals)


def test_bootstrap_is_seeded_and_wider_at_higher_confidence():
    values = [0.0, 1.0, 2.0, 10.0, 11.0]
    narrow, wide = iqm_interval(values, 0.5), iqm_interval(values, 0.99)
    assert 0 <= wide.low < narrow.low < narrow.estimate < narrow.high < wide.high <= 11
    many = np.random.default_rng(0).normal(size=20)
    assert iqm_interval(many) == iqm_interval(many) != iqm_interval(many, seed=1)


@pytest.mark.parametrize("levels", [3, 1000])  # with ties and without
def test_probability_of_improvement_is_mann_whitney(levels):
    generator = np.random.default_rng(levels)
    x, y = generator.integers(levels, size=7), generator.integers(levels, size=5)
    u = stats.mannwhitneyu(x, y).statistic
    interval = probability_of_improvement(x, y, resamples=500)
    assert interval.estimate == pytest.approx(u / 35)
    assert 0 <= interval.low <= interval.estimate <= interval.high <= 1
    opposite = probability_of_improvement(y, x, resamples=500).estimate
    assert opposite == pytest.approx(1 - interval.estimate)


def test_probability_of_improvement_by_hand():
    assert probability_of_improvement([3.0, 4.0], [1.0, 2.0]) == Interval(1, 1, 1)
    assert probability_of_improvement([1.0, 3.0], [2.0, 3.0]).estimate == (0 + 0 + 1 + 0.5) / 4


@pytest.mark.parametrize("interval", [t_interval, iqm_interval])
def test_equal_values_have_an_interval_of_no_width(interval):
    assert interval([0.3] * 5) == pytest.approx((0.3, 0.3, 0.3))


def test_equal_samples_improve_on_nothing():
    assert probability_of_improvement([2.0] * 3, [2.0] * 3) == Interval(0.5, 0.5, 0.5)


@pytest.mark.parametrize(
    "interval",
    [
        t_interval,
        iqm_interval,
        lambda v: iqm_interval([v, [3.0, 3.0, 3.0]]),
        lambda v: probability_of_improvement([3.0, 3.0], v)._replace(estimate=3),
    ],
)
def test_a_single_value_has_no_interval(interval):
    estimate, low, high = interval([3.0])
    assert estimate == 3
    assert math.isnan(low)
    assert math.isnan(high)


@pytest.mark.parametrize(
    "interval", [t_interval, iqm_interval, lambda v, c=0.9: probability_of_improvement([1.0], v, c)]
)
@pytest.mark.parametrize("values", [[], [1.0, math.nan], [[[1.0]], [[2.0]]]])
def test_values_that_have_no_interval_are_refused(interval, values):
    with pytest.raises(ValueError, match="expected a list of finite numbers"):
        interval(values)
    with pytest.raises(ValueError, match="confidence is 95"):
        interval([1.0, 2.0], 95)


@pytest.mark.parametrize("levels", [3, 10_000])  # many ties to none
def test_correlations_equal_scipy(levels):
    x, y = torch.randint(levels, (2, 4, 5, 40)).float()
    for function, oracle in ((spearman, stats.spearmanr), (pearson, stats.pearsonr)):
        got = function(x, y)
        for i in range(4):
            for j in range(5):
                expected = oracle(x[i, j], y[i, j]).statistic
                assert got[i, j].item() == pytest.approx(expected, abs=1e-7)


def test_spearman_sees_order_alone():
    x = torch.randn(50)
    assert spearman(x, x.exp()).item() == pytest.approx(1)
    assert spearman(x, -(x**3)).item() == pytest.approx(-1)


@pytest.mark.parametrize("correlation", [spearman, pearson])
def test_a_constant_has_no_correlation(correlation):
    x = torch.randn(2, 50)
    assert correlation(x, torch.full((2, 50), 0.1)).isnan().all()


@pytest.mark.parametrize("correlation", [spearman, pearson])
def test_correlations_refuse_nan_and_other_shapes(correlation):
    for y in (torch.ones(2), torch.tensor([1.0, math.nan, 2.0])):
        with pytest.raises(ValueError, match="expected equal ones, without NaN"):
            correlation(torch.ones(3), y)


def test_few_seeds_have_students_interval_and_ten_a_bootstrapped_one():
    values = torch.randn(9, generator=torch.Generator().manual_seed(0)).tolist()
    assert seeds_interval(values) == t_interval(values)
    ten = [*values, 0.5]
    assert seeds_interval(ten) == iqm_interval(ten)
    assert math.isnan(seeds_interval([1.0]).low)


@pytest.mark.parametrize("seeds", [3, 5])
def test_the_interval_of_few_seeds_covers_what_it_promises(seeds):
    """A bootstrap of so few does not: it resamples what was seen."""
    generator = torch.Generator().manual_seed(1)
    draws = torch.randn(400, seeds, generator=generator, dtype=torch.float64)
    covered = [i.low < 0 < i.high for i in map(seeds_interval, draws.tolist())]
    bootstrapped = [
        i.low < 0 < i.high for i in (iqm_interval(d, resamples=300) for d in draws.tolist())
    ]
    share, resampled = sum(covered) / 400, sum(bootstrapped) / 400
    assert 0.92 < share < 0.98
    assert resampled < 0.92
