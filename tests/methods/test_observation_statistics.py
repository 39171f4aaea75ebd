"""Statistics of observations, batch by batch, against all at once."""

import pytest
import torch

from pemirl_trl import Standardize
from pemirl_trl.methods.observation_statistics import ObservationStatistics


def test_batches_give_what_all_of_them_give_at_once():
    generator = torch.Generator().manual_seed(0)
    data = 1e3 + torch.randn(1000, 3, generator=generator) * torch.tensor([0.1, 1.0, 0.0])
    standardize = Standardize.identity(3)
    statistics = ObservationStatistics(standardize)
    for part in (data[:7], data[7:400].view(3, 131, 3), data[400:]):
        statistics.update(part)
    rows = data.double()
    torch.testing.assert_close(standardize.loc, rows.mean(0).float())
    torch.testing.assert_close(standardize.scale[:2], rows.std(0).float()[:2])
    assert standardize.scale[2] == 1.0  # it never varied


def test_a_resumed_one_continues(tmp_path):
    first, second = torch.randn(50, 2), 3 + torch.randn(70, 2)
    whole, resumed = (ObservationStatistics(Standardize.identity(2)) for _ in range(2))
    whole.update(first)
    resumed.load_state_dict(whole.state_dict())
    whole.update(second)
    resumed.update(second)
    for name, value in whole.standardize.state_dict().items():
        assert torch.equal(value, resumed.standardize.state_dict()[name])


def test_a_policys_map_follows_after_the_step(reach):
    method = reach.policy_optimization(iterations=2, standardize_observations=True)
    map_ = method.policy.gaussian.standardize
    before = map_.loc.clone()
    method.iteration()
    assert not torch.equal(map_.loc, before)
    assert method.components()["observations"].state_dict()["count"] > 0
    fixed = reach.policy_optimization(iterations=1)
    before = fixed.policy.gaussian.standardize.loc.clone()
    fixed.iteration()
    assert torch.equal(fixed.policy.gaussian.standardize.loc, before)
    assert "observations" not in fixed.components()


def test_its_step_is_that_of_a_fixed_map(reach):
    """The first step is taken before the map moves: densities of the rollouts stay those drawn."""
    torch.manual_seed(0)
    moving = reach.policy_optimization(iterations=1, standardize_observations=True)
    torch.manual_seed(0)
    fixed = reach.policy_optimization(iterations=1)
    metrics = []
    for method in (moving, fixed):
        torch.manual_seed(1)
        metrics.append(method.iteration())
    assert metrics[0] == pytest.approx(metrics[1])
