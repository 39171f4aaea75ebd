"""A reward that is known beforehand says what it must of the behaviours."""

from types import SimpleNamespace

import torch

from pemirl_lab.measuring.behaviours import behaviour_measures

NAMES = ["expert", "expert_other_task", "carried_over", "still", "random", "spearman"]


class Forward:
    """Knows the directions, forward first, and rewards the velocity along them."""

    mean = torch.tensor([[1.0], [-1.0]])

    def get_dist(self, trajectories):
        assert trajectories.batch_size[0] == 2
        return self

    def reward(self, observation, context):
        return observation[..., 13:14] * context


def test_a_reward_of_speed_prefers_the_expert_of_the_right_direction(settings):
    given, _ = settings("meta_train", "task=ant", "evaluation.episodes=1", "threads=1")
    model = SimpleNamespace(encoder=Forward(), reward=Forward(), action_dim=8)
    measured = {k.split("/")[1]: v for k, v in behaviour_measures(given, model).items()}
    assert list(measured) == NAMES
    assert measured["expert"] > 0.1 > abs(measured["still"])
    assert measured["expert_other_task"] < 0
    assert measured["expert"] > measured["random"]
    assert measured["spearman"] > 0.5
