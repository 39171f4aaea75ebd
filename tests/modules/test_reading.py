"""Mistakes of whoever puts components together end in a sentence that says what to do."""

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

from pemirl_trl.data import DemonstrationDataset
from pemirl_trl.modules import (
    AIRLDiscriminator,
    ContextEncoder,
    ContextPolicy,
    GAILDiscriminator,
    ModelConfig,
    PEMIRLModel,
    ShapedReward,
)
from pemirl_trl.modules.reading import (
    DISCRIMINATOR,
    ENCODER,
    POLICY,
    REWARD,
    MissingKeyError,
    beside,
    key_of,
    read,
    trajectories_of,
)

S, A, D, T = 3, 2, 2, 4


def parts():
    reward = ShapedReward(S, D)
    return {
        "encoder": ContextEncoder(S, A, D, T),
        "reward": reward,
        "discriminator": AIRLDiscriminator(reward),
        "gail": GAILDiscriminator(S, A),
        "policy": ContextPolicy(S, A, D),
        "model": PEMIRLModel(S, A, T, ModelConfig(context_dim=D)),
    }


def test_a_missing_key_is_named_with_its_reader_what_is_there_and_who_writes_it():
    batch = TensorDict({"observation": torch.zeros(2, S), "next": {"reward": torch.zeros(2)}}, [2])
    with pytest.raises(MissingKeyError) as error:
        read(batch, "context", "ShapedReward")
    message = str(error.value)
    assert message.startswith("ShapedReward reads 'context', which this batch lacks; it has (")
    assert "it has ('next', 'reward'), observation. " in message
    assert "InferContext writes it at reset" in message
    assert isinstance(error.value, KeyError)


def test_the_writer_of_a_renamed_key_is_known_by_its_role():
    batch = TensorDict({}, [2])
    with pytest.raises(MissingKeyError, match=r"reads 'm'.*InferContext writes it"):
        read(batch, "m", "ShapedReward", "context")
    with pytest.raises(MissingKeyError, match=r"reads 'm', which this batch lacks; it has $"):
        read(batch, "m", "ShapedReward")


def test_trajectories_are_those_of_a_data_set_and_anything_else_passes():
    dataset = DemonstrationDataset(torch.randn(5, T + 1, S), torch.randn(5, T, A))
    taken = trajectories_of(dataset)
    assert torch.equal(taken["observation"], dataset.observation[:, :-1])
    assert trajectories_of(taken) is taken
    assert trajectories_of(3) == 3


def test_a_key_of_its_own_name_or_of_an_attribute():
    plain = TensorDictModule(torch.nn.Linear(S, 1), ["observation"], ["out"])
    assert key_of(plain, "observation") == "observation"
    assert key_of(ContextPolicy(S, A, D, context_key=("task", "goal")), "context") == (
        "task",
        "goal",
    )
    with pytest.raises(ValueError, match=r"reads \['observation'\].*the key 'context', or an attr"):
        key_of(plain, "context")


@pytest.mark.parametrize("shape", [(D,), (1, D), (5, D)])
def test_one_context_serves_many_observations(shape):
    context = torch.randn(shape)
    assert torch.equal(beside(context, torch.zeros(5, S)), context.expand(5, D))


def test_one_context_per_rollout_takes_a_dimension_of_time():
    observation, context = torch.zeros(T, T, S), torch.randn(T, D)
    assert torch.equal(beside(context.unsqueeze(1), observation)[:, 2], context)
    # T rollouts of T steps: broadcasting would take the rollouts' contexts for the steps'.
    with pytest.raises(ValueError, match=r"expected \[4, 4, 2\].*context.unsqueeze\(1\)"):
        beside(context, observation)


@pytest.mark.parametrize("shape", [(3, D), (5, 1, D)])
def test_contexts_that_do_not_fit_are_refused(shape):
    with pytest.raises(ValueError, match=r"beside observations \[5, 3\]; expected \[5, 2\]"):
        beside(torch.zeros(shape), torch.zeros(5, S))


@pytest.mark.parametrize(
    ("part", "accepted"),
    [
        (ENCODER, {"encoder"}),
        (REWARD, {"reward"}),
        (DISCRIMINATOR, {"discriminator", "gail"}),
        (POLICY, {"policy"}),
    ],
)
def test_each_part_is_told_from_the_others(part, accepted):
    for name, value in parts().items():
        if name in accepted:
            part.required(value, "Somebody")
        else:
            with pytest.raises(TypeError, match=rf"Somebody takes .*, got {type(value).__name__}"):
                part.required(value, "Somebody")


@pytest.mark.parametrize(
    ("part", "name", "cure"),
    [
        (ENCODER, "model", r"got PEMIRLModel: pass its \.encoder$"),
        (POLICY, "model", r"got PEMIRLModel: pass its \.policy$"),
        (REWARD, "model", r"got PEMIRLModel: pass its \.reward$"),
        (REWARD, "discriminator", r"got AIRLDiscriminator: pass its \.reward$"),
        (REWARD, "gail", r"got GAILDiscriminator$"),  # it holds none
    ],
)
def test_a_part_at_hand_is_pointed_to(part, name, cure):
    with pytest.raises(TypeError, match=cure):
        part.required(parts()[name], "Somebody")


def test_a_cure_of_the_owner_goes_first():
    with pytest.raises(TypeError, match=r"got ShapedReward: wrap it$"):
        DISCRIMINATOR.required(parts()["reward"], "Somebody", [(ShapedReward, "wrap it")])
