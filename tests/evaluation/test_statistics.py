"""SciPy and coverage are the oracles."""

import math

import pytest
import torch

from pemirl_trl.evaluation.statistics import (
    average_ranks,
    bootstrap_interval,
    spearman,
    t_interval,
)

stats = pytest.importorskip("scipy.stats")


@pytest.mark.parametrize("n", [2, 3, 4, 5, 10, 31])
@pytest.mark.parametrize("confidence", [0.5, 0.95, 0.999])
def test_t_interval_equals_scipy(n, confidence):
    values = torch.randn(n, dtype=torch.float64) * 3 - 7
    interval = t_interval(values, confidence)
    expected = stats.t.interval(
        confidence, n - 1, loc=values.mean().item(), scale=stats.sem(values.numpy())
    )
    assert interval.mean == pytest.approx(values.mean().item())
    assert (interval.low, interval.high) == pytest.approx(expected, rel=1e-9)


def test_bootstrap_interval_agrees_with_the_normal_one_on_many_values():
    values = torch.randn(2000, dtype=torch.float64) + 5
    interval, normal = bootstrap_interval(values, resamples=4000), t_interval(values)
    assert interval.mean == pytest.approx(normal.mean)
    half = (normal.high - normal.low) / 2
    assert interval.low == pytest.approx(normal.low, abs=0.1 * half)
    assert interval.high == pytest.approx(normal.high, abs=0.1 * half)
    assert interval == bootstrap_interval(values, resamples=4000)  # seeded


def test_bootstrap_interval_is_wider_at_higher_confidence_and_inside_the_range():
    values = [0.0, 1.0, 2.0, 10.0]
    narrow, wide = bootstrap_interval(values, 0.5), bootstrap_interval(values, 0.99)
    assert 0 <= wide.low < narrow.low < narrow.mean < narrow.high < wide.high <= 10


@pytest.mark.parametrize("interval", [t_interval, bootstrap_interval])
def test_one_value_has_a_mean_and_no_interval(interval):
    mean, low, high = interval([3.0])
    assert mean == 3
    assert math.isnan(low)
    assert math.isnan(high)


@pytest.mark.parametrize("interval", [t_interval, bootstrap_interval])
@pytest.mark.parametrize("values", [[], [1.0, math.nan], [[1.0], [2.0]]])
def test_values_that_have_no_interval_are_refused(interval, values):
    with pytest.raises(ValueError, match="expected a list of finite numbers"):
        interval(values)
    with pytest.raises(ValueError, match="confidence is 95"):
        interval([1.0, 2.0], 95)


@pytest.mark.parametrize("levels", [3, 10, 10_000])  # many ties to none
def test_ranks_and_spearman_equal_scipy(levels):
    x, y = torch.randint(levels, (2, 4, 5, 40)).float()
    assert torch.equal(average_ranks(x), torch.as_tensor(stats.rankdata(x, axis=-1)) - 1)
    got = spearman(x, y)
    for i in range(4):
        for j in range(5):
            expected = stats.spearmanr(x[i, j], y[i, j]).statistic
            assert got[i, j].item() == pytest.approx(expected, abs=1e-12)


def test_spearman_sees_order_alone():
    x = torch.randn(50)
    assert spearman(x, x.exp()).item() == pytest.approx(1)
    assert spearman(x, -(x**3)).item() == pytest.approx(-1)
    assert spearman(x, torch.ones(50)).isnan()


def test_spearman_refuses_nan_and_other_shapes():
    for y in (torch.ones(2), torch.tensor([1.0, math.nan, 2.0])):
        with pytest.raises(ValueError, match="expected equal ones, without NaN"):
            spearman(torch.ones(3), y)
