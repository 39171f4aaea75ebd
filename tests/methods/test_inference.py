"""One demonstration's context, reward and distance from the family of training."""

from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from pemirl_trl import (
    DemonstrationDataset,
    PEMIRLModel,
    PortableReward,
    adapt,
    infer,
    load_model,
)

GOLDEN = Path(__file__).parents[1] / "golden" / "file_version_1"


def test_the_context_is_the_mean_of_the_posterior(trained, dataset):
    one = dataset(torch.tensor([[0.3]]))
    inference = infer(trained, one)
    expected = trained.encoder.get_dist(one.trajectories())
    torch.testing.assert_close(inference.context, expected.mean[0])
    torch.testing.assert_close(inference.posterior.stddev, expected.stddev[0])
    assert inference.posterior.batch_shape == ()
    assert inference.context.shape == (2,)


def test_the_reward_is_that_of_the_demonstrated_goal(trained, dataset):
    states = torch.linspace(-1.25, 1.25, 101).unsqueeze(-1)
    for goal in (-0.6, 0.0, 0.6):
        reward = infer(trained, dataset(torch.tensor([[goal]]))).reward(states)
        assert reward.shape == (101, 1)
        assert not reward.requires_grad
        assert abs(float(states[reward.argmax()]) - goal) < 0.4


@torch.no_grad()
def means(policy, states, inference):
    batch = states.shape[:-1]
    given = {"observation": states, "context": inference.context.expand(*batch, -1)}
    return policy.get_dist(TensorDict(given, batch)).mean


def test_the_action_is_the_policys_mean_for_this_demonstration(trained, dataset):
    inference = infer(trained, dataset(torch.tensor([[0.3]])))
    states = torch.linspace(-1, 1, 6, dtype=torch.float64).view(2, 3, 1)
    mean = means(trained.policy, states.float(), inference)
    action = inference.action(states)
    torch.testing.assert_close(action, mean)
    assert not action.requires_grad
    torch.testing.assert_close(inference.action(states[0, 0]), mean[0, 0])
    drawn = inference.action(states, sample=True)
    assert (drawn - mean).abs().min() > 0


def test_the_action_of_another_policy_is_that_policys(trained, dataset):
    inference = infer(trained, dataset(torch.tensor([[0.3]])))
    other = trained.new_policy()
    states = torch.linspace(-1, 1, 6).unsqueeze(-1)
    mean = means(other, states, inference)
    torch.testing.assert_close(inference.action(states, other), mean)
    with pytest.raises(ValueError, match=r"got states \[5, 2\]; expected \[..., 1\]"):
        inference.action(torch.zeros(5, 2))


def test_a_reward_alone_brings_no_policy(trained, dataset):
    inference = infer(PortableReward.of(trained), dataset(torch.tensor([[0.3]])))
    states = torch.zeros(5, 1)
    with pytest.raises(ValueError, match="a reward brings no policy"):
        inference.action(states)
    assert inference.action(states, trained.policy).shape == (5, trained.action_dim)


def test_states_of_another_size_are_refused(trained, dataset):
    with pytest.raises(ValueError, match=r"got states \[5, 2\]; expected \[..., 1\]"):
        infer(trained, dataset(torch.tensor([[0.3]]))).reward(torch.zeros(5, 2))


def test_the_distance_separates_the_family_from_others(trained, dataset):
    inside = [infer(trained, dataset(torch.tensor([[g]]))).distance for g in (-0.9, -0.35, 0.55)]
    outside = [infer(trained, dataset(torch.tensor([[g]]))).distance for g in (-2.4, 2.4)]
    assert not any(distance.far for distance in inside)
    assert max(d.worst for d in inside) < 0.2 < 1.0 < min(d.worst for d in outside)
    assert max(d.context for d in inside) < min(d.context for d in outside)
    position = 50.0 * torch.ones(1, 11, 1)
    elsewhere = DemonstrationDataset(position, torch.ones(1, 10, 1))
    assert infer(trained, elsewhere).distance.far


def test_an_old_file_does_not_know_its_family():
    model = load_model(GOLDEN / "model.safetensors")
    one = DemonstrationDataset(torch.randn(1, 5, 3), torch.randn(1, 4, 2))
    inference = infer(model, one)
    assert inference.distance is None
    assert str(inference).endswith(
        "distance: unknown: the model does not say what it was trained on"
    )


def test_several_demonstrations_are_refused(trained, dataset):
    with pytest.raises(ValueError, match="got 2 demonstrations; expected one, such as"):
        infer(trained, dataset(torch.tensor([[0.3], [0.5]])))


def test_a_demonstration_of_another_size_is_refused(trained):
    other = DemonstrationDataset(torch.zeros(1, 6, 3), torch.ones(1, 5, 1))
    with pytest.raises(
        ValueError, match=r"\(S, A, T\) = \(3, 1, 5\).* was trained on \(1, 1, 10\)"
    ):
        infer(trained, other)


def test_a_model_without_contexts_infers_nothing(reach, dataset):
    model: PEMIRLModel = reach.model(context_dim=0)
    with pytest.raises(ValueError, match="this model infers no reward"):
        infer(model, dataset(torch.tensor([[0.3]])))


def test_states_are_any_array_of_numbers(trained, dataset):
    inference = infer(trained, dataset(torch.tensor([[0.3]])))
    expected = inference.action(torch.tensor([0.5]))
    torch.testing.assert_close(inference.action([0.5]), expected)
    torch.testing.assert_close(inference.action(np.array([0.5])), expected)
    torch.testing.assert_close(inference.reward([[0.5]]), inference.reward(torch.tensor([[0.5]])))


def test_the_name_of_a_models_file_is_no_model(dataset, make_env):
    one = dataset(torch.tensor([[0.3]]))
    cure = r"got a model of type str; expected .*: load_model\('mine.safetensors'\)"
    with pytest.raises(TypeError, match=cure):
        infer("mine.safetensors", one)
    with pytest.raises(TypeError, match=cure):
        adapt("mine.safetensors", one, make_env)
