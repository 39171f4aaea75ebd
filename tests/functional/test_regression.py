"""The batched ridge regression against LAPACK's least squares."""

import torch

from pemirl_trl.functional import ridge_prediction, time_polynomial_features


def test_without_a_penalty_it_is_least_squares(float64):
    features, target = torch.randn(3, 40, 5), torch.randn(3, 40)
    solution = torch.linalg.lstsq(features, target.unsqueeze(-1)).solution
    expected = (features @ solution).squeeze(-1)
    assert torch.allclose(ridge_prediction(features, target, ridge=0.0), expected)


def test_the_penalty_is_that_of_an_augmented_problem(float64):
    """Ridge is least squares with rows sqrt(ridge B) I and targets 0 appended."""
    features, target, ridge = torch.randn(3, 40, 5), torch.randn(3, 40), 0.1
    rows = (ridge * 40) ** 0.5 * torch.eye(5).expand(3, 5, 5)
    augmented = torch.cat([features, rows], 1)
    padded = torch.cat([target, torch.zeros(3, 5)], 1).unsqueeze(-1)
    expected = (features @ torch.linalg.lstsq(augmented, padded).solution).squeeze(-1)
    assert torch.allclose(ridge_prediction(features, target, ridge), expected)


def test_collinear_features_are_no_trouble(float64):
    column = torch.randn(1, 30, 1)
    prediction = ridge_prediction(column.expand(-1, -1, 4), 2 * column.squeeze(-1))
    assert torch.allclose(prediction, 2 * column.squeeze(-1), rtol=1e-4)


def test_problems_do_not_mix(float64):
    features, target = torch.randn(2, 20, 3), torch.randn(2, 20)
    both = ridge_prediction(features, target)
    for m in range(2):
        alone = ridge_prediction(features[m : m + 1], target[m : m + 1])
        assert torch.allclose(both[m : m + 1], alone)


def test_features_by_hand(float64):
    observation = torch.tensor([[2.0], [3.0]])  # T = 2: t = 0 and 1/2
    expected = torch.tensor([[2, 4, 0, 0, 0, 1], [3, 9, 0.5, 0.25, 0.125, 1]])
    assert torch.allclose(time_polynomial_features(observation), expected)
    assert time_polynomial_features(torch.zeros(4, 3, 7, 2)).shape == (4, 3, 7, 8)
