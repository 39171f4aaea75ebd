"""A batch as LeRobot has it gives one reward for each of its states."""

import pytest
import torch

from pemirl_trl import BatchReward, ModelConfig, PEMIRLModel

M = [0.3, -0.2]


@pytest.fixture
def model():
    torch.manual_seed(0)
    return PEMIRLModel(3, 1, 5, ModelConfig(context_dim=2))


def test_one_reward_a_state(model):
    state = torch.randn(6, 3)
    expected = model.reward.reward(state, torch.tensor(M)).squeeze(-1).detach()
    got = BatchReward(model, M).compute_reward({"observation.state": state})
    assert torch.equal(got, expected)
    assert not got.requires_grad


def test_of_a_history_the_last_state_counts(model):
    state = torch.randn(6, 4, 3)
    reward = BatchReward(model, M, state_key="observation.environment_state")
    got = reward.compute_reward({"observation.environment_state": state, "action": state})
    now = {"observation.environment_state": state[:, -1]}
    assert torch.equal(got, reward.compute_reward(now))


@pytest.mark.parametrize(
    ("batch", "error", "message"),
    [
        ({"action": torch.zeros(1)}, KeyError, "the batch has .*action.*observation.state"),
        ({"observation.state": torch.zeros(3)}, ValueError, "expected .B, S. or .B, n, S."),
        ({"observation.state": torch.zeros(2, 4)}, ValueError, "expected .*3"),
    ],
)
def test_a_wrong_batch_is_said(model, batch, error, message):
    with pytest.raises(error, match=message):
        BatchReward(model, M).compute_reward(batch)
