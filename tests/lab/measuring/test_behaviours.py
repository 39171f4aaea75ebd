"""A reward that is known beforehand says what it must of the behaviours."""

from types import SimpleNamespace

import pytest
import torch

from pemirl_lab.measuring.behaviours import behaviour_measures
from pemirl_lab.measuring.scores import load_test_demonstrations
from pemirl_trl.methods import METHODS, new_model

NAMES = ["expert", "expert_other_task", "carried_over", "still", "random", "spearman"]


class Forward:
    """Knows the directions, forward first, and rewards the velocity along them."""

    mean = torch.tensor([[1.0], [-1.0]])

    def get_dist(self, trajectories):
        assert trajectories.batch_size[0] == 2
        return self

    def __call__(self, rollouts):
        speed = rollouts["observation"][..., 13:14]
        return rollouts.set("learned_reward", speed * rollouts["context"])


def test_a_reward_of_speed_prefers_the_expert_of_the_right_direction(settings):
    given, _ = settings("meta_train", "task=ant", "evaluation.episodes=1", "threads=1")
    model = SimpleNamespace(encoder=Forward(), reward=Forward(), action_dim=8)
    measured = {k.split("/")[1]: v for k, v in behaviour_measures(given, model).items()}
    assert list(measured) == NAMES
    assert measured["expert"] > 0.1 > abs(measured["still"])
    assert measured["expert_other_task"] < 0
    assert measured["expert"] > measured["random"]
    assert measured["spearman"] > 0.5


@pytest.mark.parametrize("method", ["airl", "meta_infogail", "pemirl"])
def test_every_kind_of_reward_is_measured(settings, method):
    given, _ = settings("meta_train", "task=ant", "evaluation.episodes=1", "threads=1")
    model = new_model(load_test_demonstrations(given), METHODS[method])
    measured = behaviour_measures(given, model)
    assert [name.split("/")[1] for name in measured] == NAMES
    told = measured["behaviour/expert"] == measured["behaviour/expert_other_task"]
    assert told == (method != "pemirl")  # the others' rewards read no context
