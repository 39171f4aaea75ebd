"""An adapted policy's file: what is read is what was written, for the same model alone."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from pemirl_trl import ModelConfig, PEMIRLModel, load_policy, save_model, save_policy
from pemirl_trl.files import read_metadata


def model(observation_dim=3, actions="continuous"):
    config = ModelConfig(context_dim=2, policy_hidden=(4,), actions=actions, policy_scale=0.5)
    return PEMIRLModel(observation_dim, 2, 5, config)


@pytest.mark.parametrize("actions", ["continuous", "discrete"])
@pytest.mark.parametrize("activation", ["relu", "tanh"])
def test_what_is_read_is_what_was_written(tmp_path, actions, activation):
    its = model(actions=actions)
    policy = its.new_policy(activation=activation)
    save_policy(tmp_path / "policy.safetensors", policy, activation, {"env_steps": "7"})
    again = load_policy(tmp_path / "policy.safetensors", its)
    assert read_metadata(tmp_path / "policy.safetensors")["env_steps"] == "7"
    assert type(again) is type(policy)
    states = TensorDict({"observation": torch.randn(9, 3), "context": torch.randn(9, 2)}, [9])
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        assert torch.equal(policy(states.clone())["action"], again(states.clone())["action"])
    for name, value in policy.state_dict().items():
        assert torch.equal(again.state_dict()[name], value), name


def test_a_policy_of_another_model_is_refused(tmp_path):
    save_policy(tmp_path / "policy.safetensors", model().new_policy(), "relu")
    with pytest.raises(ValueError, match="does not fit the modules"):
        load_policy(tmp_path / "policy.safetensors", model(observation_dim=4))


def test_other_weights_are_no_adapted_policy(tmp_path):
    save_model(tmp_path / "model.safetensors", model())
    message = "model.safetensors holds weights of .*; expected an adapted policy"
    with pytest.raises(ValueError, match=message):
        load_policy(tmp_path / "model.safetensors", model())
