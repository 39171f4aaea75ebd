"""Demonstrations without actions: read where the encoder reads states alone, else refused."""

import dataclasses

import pytest
import torch

from pemirl_trl import DemonstrationDataset, ModelConfig, PEMIRLModel, adapt, infer, meta_train
from pemirl_trl.methods import METHODS, meta_training_config, new_model
from pemirl_trl.sharing import PortableReward

ENCODERS = ("flat", "masked", "attention")
GOALS = torch.tensor([[-0.4], [0.5]])


def without_actions(data):
    return DemonstrationDataset.from_episodes(
        [(observation, None) for observation in data.observation],
        terminated=data.terminated if data.terminated is None else data.terminated.tolist(),
    )


def model(encoder="flat", reads="states", **config):
    return PEMIRLModel(1, 1, 10, ModelConfig(encoder=encoder, encoder_reads=reads, **config))


@pytest.mark.parametrize("encoder", ENCODERS)
def test_the_posterior_is_that_of_the_same_demonstration_with_actions(encoder, dataset):
    data, of_states = dataset(GOALS), model(encoder)
    seen, unseen = (infer(of_states, d[0]) for d in (data, without_actions(data)))
    assert torch.equal(seen.context, unseen.context)
    assert torch.equal(seen.posterior.stddev, unseen.posterior.stddev)
    assert torch.equal(
        infer(PortableReward.of(of_states), without_actions(data)[0]).context, seen.context
    )


def test_with_absorbing_states_too(dataset):
    data = dataset(GOALS)
    pairs = [(o[:7], a[:6]) for o, a in zip(data.observation, data.action, strict=True)]
    ended = DemonstrationDataset.from_episodes(pairs, terminated=True)
    of_states = PEMIRLModel(2, 1, 10, ModelConfig(encoder_reads="states", absorbing=True))
    seen, unseen = (infer(of_states, d[0]).context for d in (ended, without_actions(ended)))
    assert torch.equal(seen, unseen)


@pytest.mark.parametrize("encoder", ENCODERS)
def test_what_was_done_is_not_read(encoder, dataset):
    data = dataset(GOALS)
    other = dataclasses.replace(data, action=torch.full_like(data.action, torch.nan).nan_to_num(9))
    for reads, same in (("states", True), ("states_and_actions", False)):
        chosen = model(encoder, reads)
        assert torch.equal(infer(chosen, data[0]).context, infer(chosen, other[0]).context) == same


def test_an_encoder_of_actions_says_what_would_do(dataset):
    of_actions, unseen = model(reads="states_and_actions"), without_actions(dataset(GOALS))
    for ask in (lambda: infer(of_actions, unseen[0]), lambda: adapt(of_actions, unseen, None)):
        with pytest.raises(ValueError, match=r"reads actions, and of these.*encoder_reads=states"):
            ask()
    with pytest.raises(ValueError, match="reads actions, and of these"):
        of_actions.encoder.get_dist(unseen.trajectories())


def test_training_without_actions_is_refused(dataset):
    unseen, message = without_actions(dataset(GOALS)), "have no actions: Meta-IL imitates"
    with pytest.raises(ValueError, match=message):
        meta_train(None, unseen)
    with pytest.raises(ValueError, match=message):
        meta_training_config(unseen)
    with pytest.raises(ValueError, match=message):
        new_model(unseen, METHODS["pemirl"])


def test_a_policy_is_trained_on_a_demonstration_without_actions(make_env, dataset):
    """Of a model that was meta-trained with actions; bit for bit what they would have given."""
    data = dataset(torch.linspace(-1, 1, 8).unsqueeze(-1))
    few = {"iterations": 2, "rollouts_per_context": 2}
    trained = meta_train(
        *(make_env, data),
        model={"encoder_reads": "states", "context_dim": 2},
        meta_il={"steps": 4, "steps_per_iteration": 2},
        contexts_per_batch=4,
        training=few,
    )
    assert trained.config.encoder_reads == "states"
    new = dataset(GOALS)
    short = {"rollouts": 4, "optimization": {"iterations": 2}, "initial_policy": "fresh"}
    seen, unseen = (adapt(trained, d, make_env, **short) for d in (new, without_actions(new)))
    assert seen.learned_return == unseen.learned_return
    for name, weights in seen.policy.state_dict().items():
        assert torch.equal(weights, unseen.policy.state_dict()[name])
