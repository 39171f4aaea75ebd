"""A context that says the task is told from one that says how a demonstration went."""

import copy
import logging

import pytest
import torch

from pemirl_trl import meta_train
from pemirl_trl.methods.consistency import recovered_share, unrecovered
from pemirl_trl.methods.environments import Episodes


@pytest.fixture
def pile(dataset):
    return dataset(torch.linspace(-1.0, 1.0, 60).unsqueeze(-1))


def test_contexts_of_a_trained_model_are_recovered(trained, pile, make_env):
    state = torch.get_rng_state()
    share = recovered_share(trained, pile, Episodes(make_env, trained, pile), 0)
    assert 0.85 < share <= 1
    assert torch.equal(torch.get_rng_state(), state)
    assert unrecovered(share) == []


def test_those_of_a_policy_that_does_not_care_are_not(trained, pile, make_env):
    other = copy.deepcopy(trained)
    other.policy = trained.new_policy()
    share = recovered_share(other, pile, Episodes(make_env, other, pile), 0)
    assert share < 0.5
    assert "of a context is typically recovered; below 0.85 is a sign" in unrecovered(share)[0]


def test_meta_training_says_so(pile, make_env, few, caplog, monkeypatch):
    monkeypatch.setattr("pemirl_trl.methods.consistency.LEAST_RECOVERED", 1.1)
    hardly = {**few, "meta_il": {"steps": 100}, "training": {"iterations": 1}}
    with caplog.at_level(logging.WARNING, "pemirl_trl"):
        meta_train(make_env, pile, **hardly)
    assert "m does not say the task alone, or the policy does not imitate" in caplog.text
