"""The doctor finds what was planted, and nothing in sound demonstrations."""

from pathlib import Path

import pytest
import torch

from pemirl_trl.data import DemonstrationDataset, examine

ROOT = Path(__file__).parents[2]
M, T, S, A = 20, 60, 3, 2
TRULY_THERE = {  # the height of a table
    name: [
        "warning: observation is constant (feature 19); leave it out, unless it varies elsewhere"
    ]
    for name in ("sweeper_train", "sweeper_test")
}


@pytest.fixture
def sound():
    """Walks from near the origin to goals of all directions, by bounded actions."""
    goals = 3 * torch.randn(M, 1, S)
    progress = torch.linspace(0, 1, T + 1)[:, None]
    observation = 0.05 * torch.randn(M, 1, S) + goals * progress + 0.003 * torch.randn(M, T + 1, S)
    return observation, torch.rand(M, T, A) * 2 - 1


def findings(observation, action, bounds=None):
    return [str(f) for f in examine(DemonstrationDataset(observation, action), bounds)]


def only(found):
    """The one finding."""
    assert len(found) == 1, found
    return found[0]


@pytest.mark.parametrize("path", sorted((ROOT / "data").glob("*_t*.safetensors")), ids=str)
@pytest.mark.parametrize("bounds", [None, (-1.0, 1.0)])
def test_published_demonstrations_are_sound(path, bounds):
    found = [str(f) for f in examine(DemonstrationDataset.load(path), bounds)]
    assert found == TRULY_THERE.get(path.stem, [])


def test_sound_ones_are_sound(sound):
    assert findings(*sound) == findings(*sound, (-1, [1, 1])) == []


def test_a_reset_inside_an_episode(sound):
    observation, action = sound
    observation[4, 31:] = observation[9, : T - 30].clone()
    message = only([f for f in findings(observation, action) if f.startswith("error")])
    assert "reset inside an episode (episode 4; in episode 4 after step 30)" in message


def test_two_episodes_in_each_row(sound):
    observation, action = sound
    observation[:, 31:] = observation[:, : T - 30].clone()
    assert "reset inside an episode (episodes 0, 1" in findings(observation, action)[0]


def test_a_jump(sound):
    observation, action = sound
    observation[7, 20, 1] += 100
    assert "20 times the usual (feature 1 in episode 7)" in only(findings(observation, action))


def test_constant_features(sound):
    observation, action = sound
    observation[..., 2] = 5
    action[..., 0] = 0
    first, second = findings(observation, action)
    assert "observation is constant (feature 2)" in first
    assert "action is constant (feature 0)" in second


def test_duplicated_episodes(sound):
    observation, action = sound
    for x in (observation, action):
        x[[3, 11]] = x[1].clone()
    message = only(findings(observation, action))
    assert "duplicated demonstrations (episodes 3, 11, equal to earlier ones)" in message


@pytest.mark.parametrize("factor", [1e4, 1e-5])
def test_actions_of_absurd_scale(sound, factor):
    observation, action = sound
    action[..., 1] *= factor
    assert "actions of scale" in only(findings(observation, action))
    assert "(feature 1)" in only(findings(observation, action))


@pytest.mark.parametrize("factor", [57.3, 1e4])
def test_actions_far_outside_their_bounds(sound, factor):
    observation, action = sound
    message = only(findings(observation, factor * action, ([-1, -1], [1, 1])))
    assert message.startswith("error: actions far outside their bounds (features 0, 1 in episodes")


def test_one_action_far_outside_its_bounds(sound):
    observation, action = sound
    action[6, 5, 0] = 50
    message = only(findings(observation, action, (-1, 1)))
    assert "outside their bounds (feature 0 in episode 6)" in message


def test_actions_that_hardly_use_their_bounds(sound):
    observation, action = sound
    assert "hardly use their bounds" in only(findings(observation, action, (-1e4, 1e4)))


@pytest.mark.parametrize("bounds", [(1, -1), ([-1], [1, 1, 1]), (0, 0)])
def test_bounds_that_are_none_are_refused(sound, bounds):
    with pytest.raises(ValueError, match=r"action_bounds are .*; expected"):
        findings(*sound, bounds)


@pytest.mark.parametrize(("end", "name"), [(-1, "last"), (0, "first")])
def test_padded_actions(sound, end, name):
    observation, action = sound
    action[:, end] = 0
    assert f"error: the {name} action is all zero" in only(findings(observation, action))


@pytest.mark.parametrize(("to", "of", "name"), [(-1, -2, "last"), (0, 1, "first")])
def test_repeated_observations(sound, to, of, name):
    observation, action = sound
    observation[:, to] = observation[:, of]
    assert f"the {name} step changes nothing" in only(findings(observation, action))


def test_actions_that_end_in_rest_are_no_padding(sound):
    observation, action = sound
    action[:, -10:] = 0
    observation[:, -10:] = observation[:, -11:-10]
    assert findings(observation, action) == []


def test_mixed_sampling_rates():
    goals = torch.randn(M, 1, S).sign() * (2 + torch.rand(M, 1, S))
    slow = goals * torch.linspace(0, 1, T + 1)[:, None] + 0.02 * torch.randn(M, 1, S)
    slow[:5] *= 4
    message = only(findings(slow, torch.rand(M, T, A)))
    assert "as if sampled at different rates (the smaller group: episodes 0, 1, 2, 3, 4)" in message


def test_badly_scaled_features(sound):
    observation, action = sound
    observation[..., 0] *= 1e-4
    assert "than its median feature (feature 0)" in only(findings(observation, action))


def test_an_offset_that_hides_what_varies(sound):
    observation, action = sound
    observation[..., 1] += 1e5
    assert "hardly varies beside its mean" in " ".join(findings(observation, action))


def test_few_demonstrations(sound):
    observation, action = sound
    assert "few demonstrations (9 in all)" in only(findings(observation[:9], action[:9]))


@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (2, 1), (3, 3), (12, 1)])
@pytest.mark.parametrize("value", [torch.zeros, torch.randn])
def test_short_and_still_data_are_no_trouble(shape, value):
    m, t = shape
    for finding in examine(DemonstrationDataset(value(m, t + 1, S), value(m, t, A))):
        assert "\n" not in str(finding)


def test_errors_come_first(sound):
    observation, action = sound
    observation[..., 2] = 5
    action[:, -1] = 0
    severities = [f.severity for f in examine(DemonstrationDataset(observation, action))]
    assert severities == ["error", "warning"]


def test_components_of_an_action_of_different_sizes(sound):
    observation, action = sound
    action = 10.0 * action
    action[..., 1] *= 0.01
    assert "actions 10 times smaller than the largest" in only(findings(observation, action))
