import pytest
import torch

from pemirl_envs import get_task
from pemirl_envs.episodes import Episodes

GOAL = {"goal": torch.tensor([[0.1, 0.5], [0.2, 0.5], [0.3, 0.5], [0.4, 0.5]])}


@pytest.fixture
def episodes():
    return Episodes(get_task("point_maze/left"), 4, split="train_100", seed=0, num_threads=1)


def rows(*indices):
    mask = torch.zeros(4, dtype=torch.bool)
    mask[list(indices)] = True
    return mask


def snapshot(episodes):
    return episodes.simulation.state, dict(episodes.parameters), episodes.step_count


def test_the_random_stream_depends_on_neither_masks_nor_given_tasks(episodes):
    resets = [{}, {"mask": rows(1)}, {"mask": rows()}, {"parameters": GOAL}]
    episodes.reset()
    start, ends = episodes.generator.get_state(), []
    for reset in resets:
        episodes.generator.set_state(start)
        episodes.reset(**reset)
        ends.append(episodes.generator.get_state())
    assert not torch.equal(start, ends[0])
    assert all(torch.equal(end, ends[0]) for end in ends)


def test_given_tasks_do_not_change_where_episodes_begin(episodes):
    episodes.reset()
    first = episodes.observe()
    episodes.seed(0)
    episodes.reset(parameters=GOAL)
    assert torch.equal(episodes.observe(), first)
    assert torch.equal(episodes.parameters["goal"], GOAL["goal"])


def test_a_masked_reset_leaves_the_others_as_they_were(episodes):
    episodes.reset()
    for _ in range(3):
        episodes.step(torch.ones(4, 2))
    state, parameters, count = snapshot(episodes)
    mask = rows(0, 2)
    episodes.reset(mask, GOAL)
    assert torch.equal(episodes.simulation.state[~mask], state[~mask])
    assert torch.equal(episodes.parameters["goal"][~mask], parameters["goal"][~mask])
    assert torch.equal(episodes.parameters["goal"][mask], GOAL["goal"][mask])
    assert episodes.step_count.tolist() == [0, 3, 0, 3]
    assert count.tolist() == [3, 3, 3, 3]  # what was handed out is never edited


def test_goals_are_checked_where_they_are_used(episodes):
    episodes.reset()
    outside = {"goal": GOAL["goal"].clone()}
    outside["goal"][1] = torch.tensor([0.61, 0.5])
    outside["goal"][3] = torch.nan
    episodes.reset(rows(0, 2), outside)
    with pytest.raises(ValueError, match=r"goal of simulation\(s\) \[1\] is .*0.61.* lie between"):
        episodes.reset(rows(0, 1), outside)
    with pytest.raises(ValueError, match=r"goal of simulation\(s\) \[1, 3\]"):
        episodes.reset(parameters=outside)


def test_a_refused_reset_changes_nothing(episodes):
    episodes.reset()
    state, parameters, _ = snapshot(episodes)
    stream = episodes.generator.get_state()
    with pytest.raises(ValueError, match="goal"):
        episodes.reset(parameters={"goal": GOAL["goal"] + 1})
    assert torch.equal(episodes.generator.get_state(), stream)
    assert torch.equal(episodes.simulation.state, state)
    assert torch.equal(episodes.parameters["goal"], parameters["goal"])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"target": GOAL["goal"]}, r"expected the task parameters \['goal'\], got \['target'\]"),
        ({"goal": torch.zeros(4, 3)}, r"expected goal of shape \[4, 2\], got \[4, 3\]"),
        ({"goal": torch.zeros(2)}, r"expected goal of shape \[4, 2\], got \[2\]"),
        ({"goal": torch.zeros(3, 2)}, r"expected goal of shape \[4, 2\], got \[3, 2\]"),
    ],
)
@pytest.mark.parametrize("mask", [None, rows(1)])
def test_malformed_tasks_are_refused(episodes, given, message, mask):
    episodes.reset()
    with pytest.raises(ValueError, match=message):
        episodes.reset(mask, given)


def test_bad_actions_stop_their_own_simulations_alone(episodes):
    twin = Episodes(episodes.task, 4, split="train_100", seed=0, num_threads=1)
    for each in (episodes, twin):
        each.reset()
    action = torch.full((4, 2), 0.5)
    expected, _ = twin.step(action)
    before = episodes.observe()
    action[1, 0] = torch.nan
    action[3, 1] = torch.inf
    reward, failures = episodes.step(action)
    assert failures == dict.fromkeys((1, 3), "the action is not finite")
    healthy = rows(0, 2)
    assert torch.equal(reward[healthy], expected[healthy])
    assert reward[~healthy].isnan().all()
    assert torch.equal(episodes.observe()[healthy], twin.observe()[healthy])
    assert torch.equal(episodes.observe()[~healthy], before[~healthy])
    assert episodes.step_count.tolist() == [1, 0, 1, 0]

    reward, failures = episodes.step(torch.full((4, 2), 0.5))  # the failed may act again
    assert failures == {}
    assert torch.equal(reward[~healthy], expected[~healthy])


def test_all_simulations_may_fail(episodes):
    episodes.reset()
    reward, failures = episodes.step(torch.full((4, 2), torch.nan))
    assert list(failures) == [0, 1, 2, 3]
    assert reward.isnan().all()


def test_transition_noise_skips_what_failed():
    episodes = Episodes(get_task("point_maze/stochastic"), 3, split="test", seed=0)
    episodes.reset()
    before = episodes.observe()
    episodes.step(torch.tensor([[0.0, 0.0], [0.0, torch.nan], [0.0, 0.0]]))
    moved = (episodes.observe() != before).all(-1)
    assert moved.tolist() == [True, False, True]


def test_a_masked_step_moves_and_rewards_the_others_alone(episodes):
    twin = Episodes(episodes.task, 4, split="train_100", seed=0, num_threads=1)
    for each in (episodes, twin):
        each.reset()
    action, mask = torch.full((4, 2), 0.5), rows(0, 2)
    action[1] = torch.nan  # plays no part
    before = episodes.observe()
    reward, failures = episodes.step(action, mask)
    expected, _ = twin.step(torch.full((4, 2), 0.5))
    assert failures == {}
    assert torch.equal(reward[mask], expected[mask])
    assert (reward[~mask] == 0).all()
    assert torch.equal(episodes.observe()[mask], twin.observe()[mask])
    assert torch.equal(episodes.observe()[~mask], before[~mask])
    assert episodes.step_count.tolist() == [1, 0, 1, 0]

    action[0] = torch.inf
    reward, failures = episodes.step(action, mask)
    assert failures == {0: "the action is not finite"}
    assert reward.isnan().tolist() == [True, False, False, False]
    assert episodes.step_count.tolist() == [1, 0, 2, 0]


def test_episodes_may_end_before_the_horizon():
    episodes = Episodes(get_task("point_maze/left"), 1, seed=0, max_steps=2)
    episodes.reset()
    ends = []
    for _ in range(3):
        episodes.step(torch.zeros(1, 2))
        ends.append(episodes.truncated().item())
    assert ends == [False, True, True]


def test_order_of_calls(episodes):
    with pytest.raises(RuntimeError, match="reset the environment before its first step"):
        episodes.step(torch.zeros(4, 2))
    with pytest.raises(ValueError, match="the first reset must cover every simulation"):
        episodes.reset(rows(0))


@pytest.mark.parametrize("shape", [(4,), (4, 3), (3, 2), (1, 4, 2)])
def test_actions_of_a_wrong_shape_are_refused(episodes, shape):
    episodes.reset()
    with pytest.raises(ValueError, match=r"expected an action of shape \(4, 2\), got"):
        episodes.step(torch.zeros(shape))


def test_an_unknown_split_is_refused():
    with pytest.raises(ValueError, match="unknown split 'nonsense'; expected one of"):
        Episodes(get_task("point_maze/left"), 1, split="nonsense")
