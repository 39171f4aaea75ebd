"""Advantages of the finite-horizon problem, by hand: nothing is bootstrapped at the end."""

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torchrl.objectives.value.functional import generalized_advantage_estimate

from pemirl_trl.functional import discounted_return, ridge_prediction, time_polynomial_features
from pemirl_trl.modules import ContextValue
from pemirl_trl.objectives import FiniteHorizonAdvantage, ValueLoss

from .problems import D, K, M, N, S, T, networks, rollouts

pytestmark = pytest.mark.usefixtures("float64")

REWARD = [1.0, 2.0, 4.0]
# gamma = 1/2 and V = 1: deltas 1 + 1/2 - 1, 2 + 1/2 - 1 and, at the last step, 4 + 0 - 1.
BY_HAND = {
    1.0: ([2.0, 3.0, 3.0], [3.0, 4.0, 4.0]),  # the targets are the returns-to-go
    0.5: ([1.0625, 2.25, 3.0], [2.0625, 3.25, 4.0]),  # each delta counts 1/4 a step earlier
    0.0: ([0.5, 1.5, 3.0], [1.5, 2.5, 4.0]),
}


def episode():
    reward = torch.tensor(REWARD).view(1, 3, 1)
    return TensorDict({"observation": torch.zeros(1, 3, 1), "next": {"reward": reward}}, [1, 3])


def constant_value(value):
    return TensorDictModule(
        lambda observation: torch.full_like(observation[..., :1], value),
        ["observation"],
        ["state_value"],
    )


@pytest.mark.parametrize("lmbda", BY_HAND)
def test_advantage_and_target_by_hand(lmbda):
    advantage = FiniteHorizonAdvantage(
        gamma=0.5, lmbda=lmbda, value=constant_value(1.0), standardize=None
    )
    result = advantage(episode())
    for key, expected in zip(("advantage", "value_target"), BY_HAND[lmbda], strict=True):
        assert torch.allclose(result[key].flatten(), torch.tensor(expected))


def test_a_bootstrapping_estimate_differs():
    """Treating the time limit as a truncation would add gamma V(s_T) to the last step."""
    one, no = torch.ones(1, 3, 1), torch.zeros(1, 3, 1, dtype=torch.bool)
    end = no.clone()
    end[:, -1] = True
    bootstrapped, _ = generalized_advantage_estimate(
        0.5, 1.0, one, one, episode()["next", "reward"], done=end, terminated=no
    )
    extra = bootstrapped.flatten() - torch.tensor(BY_HAND[1.0][0])
    assert torch.allclose(extra, torch.tensor([0.125, 0.25, 0.5]))


def scored():
    batch = rollouts()
    return batch.set(("next", "reward"), torch.randn(*batch.shape, 1))


def test_the_linear_baseline_is_fitted_to_each_contexts_returns():
    batch = scored()
    result = FiniteHorizonAdvantage(gamma=0.9, rollouts_per_context=K, standardize=None)(batch)
    returns = discounted_return(batch["next", "reward"].squeeze(-1), 0.9)
    features = time_polynomial_features(batch["observation"])
    of_one = discounted_return(torch.ones(K, T), 0.9)
    for m in range(M):
        rows = slice(m * K, (m + 1) * K)
        level = batch["next", "reward"][rows].mean() * of_one
        rest = (returns[rows] - level).view(1, -1)
        baseline = level + ridge_prediction(features[rows].flatten(0, 1)[None], rest).view(K, T)
        expected = returns[rows] - baseline
        assert torch.allclose(result["advantage"][rows].squeeze(-1), expected)
    assert torch.allclose(result["value_target"].squeeze(-1), returns)


def test_a_return_that_time_explains_leaves_no_advantage():
    batch = scored().set(("next", "reward"), torch.ones(M * K, T, 1))  # T - t, linear in t
    result = FiniteHorizonAdvantage(gamma=1.0, rollouts_per_context=K, standardize=None)(batch)
    assert result["advantage"].abs().max() < 1e-2
    assert result["value_target"].max() == T


@pytest.mark.parametrize("lmbda", [0.97, 1.0])
def test_a_constant_in_the_reward_leaves_the_advantages_as_they_are(lmbda):
    """Nothing ends an episode but time, so a reward's level means nothing."""
    horizon = 500  # 1 - 0.99^(T - t), the return of a constant, is far from a cubic in t here
    batch = TensorDict({"observation": torch.randn(4, horizon, 2)}, (4, horizon))
    reward = 0.01 * torch.randn(4, horizon, 1)
    advantage = FiniteHorizonAdvantage(lmbda=lmbda, rollouts_per_context=2, standardize="context")
    values = [
        advantage(batch.copy().set(("next", "reward"), reward + level))["advantage"]
        for level in (0.0, -2.0)
    ]
    assert torch.allclose(*values)


def test_standardised_advantages_and_another_reward_key():
    batch = scored()
    kwargs = {"rollouts_per_context": M * K}  # more rows than features
    raw = FiniteHorizonAdvantage(standardize=None, **kwargs)(batch.copy())["advantage"]
    batch["elsewhere"] = batch["next"].pop("reward")
    values = FiniteHorizonAdvantage(reward_key="elsewhere", **kwargs)(batch)["advantage"]
    assert torch.allclose(values, (raw - raw.mean()) / raw.std(correction=0))


def test_advantages_standardised_by_context():
    batch = scored()
    reward, scale = batch["next", "reward"], torch.tensor([1.0, 30.0, 0.1]).repeat_interleave(K)
    batch["next", "reward"] = reward * scale.view(-1, 1, 1)  # one task outweighs the others
    kwargs = {"rollouts_per_context": K, "value": constant_value(1.0)}
    raw = FiniteHorizonAdvantage(standardize=None, **kwargs)(batch.copy())["advantage"]
    values = FiniteHorizonAdvantage(standardize="context", **kwargs)(batch)["advantage"]
    for m in range(M):
        own = raw[m * K : (m + 1) * K]
        expected = (own - own.mean()) / own.std(correction=0)
        assert torch.allclose(values[m * K : (m + 1) * K], expected)


def test_an_unknown_standardisation_is_refused():
    with pytest.raises(ValueError, match=r"standardize is True; .*\('batch', 'context'\)"):
        FiniteHorizonAdvantage(standardize=True)


def test_the_map_of_observations_is_applied_before_the_fit():
    batch = scored()
    doubled = batch.copy().set("observation", 2 * batch["observation"])
    kwargs = {"rollouts_per_context": M * K}
    result = FiniteHorizonAdvantage(observation_map=lambda x: 2 * x, **kwargs)(batch)
    expected = FiniteHorizonAdvantage(**kwargs)(doubled)
    assert torch.equal(result["advantage"], expected["advantage"])


def test_rows_that_do_not_divide_are_refused():
    with pytest.raises(ValueError, match="got 6 rollouts, which 4 rollouts per context"):
        FiniteHorizonAdvantage(rollouts_per_context=4)(scored())


def test_the_value_loss_is_a_mean_square_under_any_name_of_the_value():
    network, batch = networks().value, rollouts()
    expected = (network(batch.copy())["state_value"] - batch["value_target"]).square().mean()
    assert torch.isclose(ValueLoss(network)(batch)["loss_value"], expected)
    renamed = ContextValue(
        S, D, T, hidden=(8,), standardize=network.module.standardize, value_key="elsewhere"
    )
    renamed.load_state_dict(network.state_dict())
    assert torch.isclose(ValueLoss(renamed)(batch)["loss_value"], expected)
    batch["next", "reward"] = torch.randn(N, T, 1)
    first, second = (
        FiniteHorizonAdvantage(value=value)(batch.copy()) for value in (network, renamed)
    )
    assert torch.equal(first["advantage"], second["advantage"])


@pytest.mark.parametrize("value", [None, networks().value])
def test_a_batch_that_has_lost_its_time_is_refused(value):
    with pytest.raises(ValueError, match=r"whole rollouts \[N, T\].*got reward \[24, 1\]"):
        FiniteHorizonAdvantage(value=value)(scored().reshape(-1))


@pytest.mark.parametrize(
    ("value", "key"),
    [
        (None, ("next", "reward")),
        (None, "observation"),
        (networks().value, "observation"),
        (networks().value, "context"),
    ],
)
def test_what_a_batch_lacks_is_named(value, key):
    with pytest.raises(KeyError, match=r"FiniteHorizonAdvantage reads .*which this batch lacks"):
        FiniteHorizonAdvantage(value=value)(scored().exclude(key))


def test_rewards_of_another_precision_than_the_networks_are_taken():
    batch = scored()
    advantage = FiniteHorizonAdvantage(
        rollouts_per_context=M * K, observation_map=lambda observation: observation.double()
    )
    single = advantage(batch.float())["advantage"]
    assert single.dtype == torch.float32
    assert torch.allclose(single.double(), advantage(batch)["advantage"], atol=1e-4)
