"""How far a demonstration is from those of training: by its context, and by what it observes."""

import math

import pytest
import torch

from pemirl_trl import TrainingFamily
from pemirl_trl.modules.family import mahalanobis


def family(contexts=None, observations=None):
    contexts = torch.randn(200, 2) * torch.tensor([1.0, 3.0]) if contexts is None else contexts
    observations = torch.rand(200, 5, 3) if observations is None else observations
    return TrainingFamily.fit(contexts, observations, torch.tensor([1.0, 0.5, 2.0]))


def test_the_distance_of_a_context_is_in_deviations_along_the_data():
    covariance = torch.tensor([[4.0, 0.0], [0.0, 9.0]])
    values = torch.tensor([[2.0, 0.0], [0.0, 6.0], [2.0, 3.0]])
    got = mahalanobis(values, torch.zeros(2), covariance)
    torch.testing.assert_close(got, torch.tensor([1.0, 2.0, math.sqrt(2.0)]))


def test_correlated_contexts_are_near_along_their_line_and_far_across(float64):
    line = torch.randn(500, 1) * torch.ones(2) + 0.1 * torch.randn(500, 2)
    known = family(line, torch.rand(500, 5, 3))
    along = known.distance(torch.tensor([2.0, 2.0]), torch.rand(5, 3))
    across = known.distance(torch.tensor([2.0, -2.0]), torch.rand(5, 3))
    assert along.context < 3.0 < 10.0 < across.context
    assert across.far
    assert not along.far


def test_a_context_that_never_varied_divides_by_no_zero():
    known = family(torch.zeros(10, 2), torch.rand(10, 5, 3))
    assert math.isfinite(known.distance(torch.ones(2), torch.rand(5, 3)).context)
    assert known.context_distance == 0.0


def test_the_excess_counts_from_the_edge_of_the_range_in_deviations():
    known = family(
        observations=torch.tensor([[[-1.0, 0.0, 0.0]], [[1.0, 1.0, 1.0]]]).repeat(2, 4, 1)
    )
    excess = known.excess(torch.tensor([[0.0, 0.5, 0.5], [3.0, -1.0, 1.5]]))
    torch.testing.assert_close(excess, torch.tensor([[0.0, 0.0, 0.0], [2.0, 2.0, 0.25]]))


def test_a_state_far_out_of_range_is_far_and_named():
    known = family()
    observations = torch.rand(5, 3)
    observations[2, 1] = 9.0
    distance = known.distance(torch.zeros(2), observations)
    assert distance.far
    assert distance.worst_feature == 1
    assert distance.beyond == pytest.approx(1 / 15)
    assert str(distance).startswith("FAR from the training family")
    assert str(known.distance(torch.zeros(2), torch.rand(5, 3))).startswith("within")


def test_one_demonstration_is_no_family():
    with pytest.raises(ValueError, match="got 1 demonstration; a family has at least 2"):
        family(torch.zeros(1, 2), torch.zeros(1, 5, 3))
