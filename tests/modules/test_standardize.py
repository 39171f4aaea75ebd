"""The affine map of observations."""

import pytest
import torch

from pemirl_trl.modules import Standardize


def test_fit_gives_zero_mean_and_unit_deviation_over_all_leading_dimensions(float64):
    values = 3.0 + torch.tensor([0.5, 4.0]) * torch.randn(20, 30, 2)
    fitted = Standardize.fit(values)
    result = fitted(values).reshape(-1, 2)
    assert torch.allclose(result.mean(0), torch.zeros(2), atol=1e-12)
    assert torch.allclose(result.std(0), torch.ones(2))
    assert fitted.features == 2


def test_a_constant_feature_keeps_its_scale():
    values = torch.stack([torch.randn(50), torch.full((50,), 7.0)], -1)
    fitted = Standardize.fit(values)
    assert fitted.scale[1] == 1.0
    assert torch.equal(fitted(values)[:, 1], torch.zeros(50))


def test_identity_changes_nothing():
    values = torch.randn(4, 3)
    assert torch.equal(Standardize.identity(3)(values), values)


def test_it_holds_state_and_no_parameter():
    source, target = Standardize(torch.randn(3), torch.rand(3) + 0.1), Standardize.identity(3)
    target.load_state_dict(source.state_dict())
    values = torch.randn(4, 3)
    assert torch.equal(target(values), source(values))
    assert not list(source.parameters())


def test_it_copies_what_it_is_given():
    loc = torch.zeros(2)
    standardize = Standardize(loc, torch.ones(2))
    loc.fill_(5.0)
    assert torch.equal(standardize(torch.ones(2)), torch.ones(2))


@pytest.mark.parametrize("scale", [[1.0, 0.0], [1.0, -2.0], [1.0, float("nan")]])
def test_scales_must_be_positive(scale):
    with pytest.raises(ValueError, match="positive scales, got"):
        Standardize(torch.zeros(2), torch.tensor(scale))


def test_shapes_must_agree():
    with pytest.raises(ValueError, match=r"got \(2,\) and \(3,\)"):
        Standardize(torch.zeros(2), torch.ones(3))


def test_a_feature_that_hardly_varies_is_not_blown_up():
    values = torch.randn(4000, 3) * torch.tensor([1.0, 1.0, 1e-4])
    fitted = Standardize.fit(values)
    torch.testing.assert_close(fitted.scale[2], 0.1 * fitted.scale[:2].min(), rtol=0.1, atol=0.0)
    moments = Standardize.from_moments(values.double().mean(0), values.double().var(0))
    for name, value in moments.state_dict().items():
        torch.testing.assert_close(value, fitted.state_dict()[name])


def test_alike_features_keep_their_own_scales():
    values = torch.randn(1000, 4) * torch.tensor([1.0, 0.3, 2.0, 0.15])
    assert torch.equal(Standardize.fit(values).scale, values.std(0))
