"""A context that says the task is told from one that says how a demonstration went."""

import copy
import logging
from dataclasses import replace

import pytest
import torch
from torch import nn

from pemirl_trl import meta_train
from pemirl_trl.methods.consistency import doubts, measured, recovered_share, sharpness
from pemirl_trl.methods.environments import Episodes


@pytest.fixture
def pile(dataset):
    return dataset(torch.linspace(-1.0, 1.0, 60).unsqueeze(-1))


def test_contexts_of_a_trained_model_are_recovered(trained, pile, make_env):
    state = torch.get_rng_state()
    share = recovered_share(trained, pile, Episodes(make_env, trained, pile), 0)
    assert 0.85 < share <= 1
    assert torch.equal(torch.get_rng_state(), state)
    assert doubts(replace(trained.family, recovered=share, outdone=None, displaced=None)) == []


def test_those_of_a_policy_that_does_not_care_are_not(trained, pile, make_env):
    other = copy.deepcopy(trained)
    other.policy = trained.new_policy()
    share = recovered_share(other, pile, Episodes(make_env, other, pile), 0)
    assert share < 0.5
    (doubt,) = doubts(replace(trained.family, recovered=share, outdone=None, displaced=None))
    assert "of a context is typically recovered; below 0.85 is a sign" in doubt
    assert "rewards of this model are likely wrong" in doubt
    (doubt,) = doubts(replace(trained.family, recovered=share, outdone=0.01, displaced=0.1))
    assert "a new policy may do well" in doubt


class Beside(nn.Module):
    """Minus the distance to a point beside each demonstration's goal; the context says which."""

    def __init__(self, contexts, goals, off):
        super().__init__()
        self.contexts, self.goals, self.off = contexts, goals, off

    def reward(self, observation, context):
        which = torch.cdist(context.flatten(0, -2), self.contexts).argmin(-1)
        goal = self.goals[which].view(*context.shape[:-1], 1)
        return -(observation[..., :1] - goal - self.off).abs()


@pytest.mark.parametrize("off", [0.0, 0.1, 0.5])
def test_a_demonstration_is_outdone_by_those_that_lie_nearer_to_the_maximum(trained, pile, off):
    """In closed form: demonstrations rest at their goals, 60 of them at equal distances."""
    other, seen = copy.deepcopy(trained), pile.trajectories()["observation"]
    rests = seen[:, len(seen[0]) // 2 :, 0].mean(1)
    still = copy.deepcopy(pile)
    still.observation[:] = rests.view(-1, 1, 1)  # so that nothing but where they rest counts
    contexts = other.encoder.get_dist(still.trajectories()).mean.detach()
    other.reward = Beside(contexts, rests.unsqueeze(1), off)
    gap = (rests.unsqueeze(0) - rests.unsqueeze(1) - off).abs()  # [reward, demonstration]
    nearer = (gap <= gap.diagonal().unsqueeze(1)).sum(1) - 1
    found = sharpness(other, still)
    assert found.outdone == pytest.approx(float(nearer.float().mean() / 59))
    assert (found.outdone > 0.035) == (off > 0)
    best = [sorted(range(60), key=lambda j, i=i: gap[i, j].item())[:5] for i in range(60)]
    away = [(contexts[best[i]].mean(0) - contexts[i]).norm() for i in range(60)]
    spread = contexts.var(0, correction=0).sum().sqrt()
    assert found.displaced == pytest.approx(float(torch.stack(away).median() / spread), rel=1e-4)


def test_a_reward_that_says_nothing_is_outdone_by_all(trained, pile):
    other = copy.deepcopy(trained)
    other.reward = Beside(torch.zeros(1, 2), torch.zeros(1, 1), 0.0)
    other.reward.reward = lambda observation, context: torch.zeros_like(observation[..., :1])
    assert sharpness(other, pile).outdone == 1.0


def test_what_was_measured_is_said_with_what_is_good(trained):
    family = replace(trained.family, recovered=0.95, outdone=0.1, displaced=0.1)
    assert "0.95 of a context" in measured(family)
    assert "outdone by 10.0 % of the others (3.5 % or less: good)" in measured(family)
    assert measured(replace(family, recovered=None, outdone=None, displaced=None)) == ""
    for sign in ({}, {"outdone": 0.01, "displaced": 0.5}):
        (doubt,) = doubts(replace(family, **sign))
        assert "r is blunt, or highest beside what was shown" in doubt
    assert doubts(replace(family, outdone=0.01)) == []


def test_meta_training_says_so(pile, make_env, few, caplog, monkeypatch):
    monkeypatch.setattr("pemirl_trl.methods.consistency.LEAST_RECOVERED", 1.1)
    hardly = {**few, "meta_il": {"steps": 100}, "training": {"iterations": 1}}
    with caplog.at_level(logging.WARNING, "pemirl_trl"):
        meta_train(make_env, pile, **hardly)
    assert "of a context is typically recovered; below 1.1 is a sign" in caplog.text
