import pytest
import torch

import pemirl_envs
from pemirl_envs.tasks.quantities import Component, component_slice, final_distance_to_goal

PARTS = (Component("arm", "rad", 2), Component("height", "m"), Component("ball", "m", 3))


def test_components_stand_in_their_order():
    slices = [component_slice(PARTS, part.name) for part in PARTS]
    assert slices == [slice(0, 2), slice(2, 3), slice(3, 6)]


def test_an_unknown_component_is_refused_with_the_legal_ones():
    message = "unknown component 'leg' of an observation; expected one of arm, height, ball"
    with pytest.raises(ValueError, match=message):
        component_slice(PARTS, "leg")
    with pytest.raises(ValueError, match=message):
        final_distance_to_goal(PARTS, "leg")
    with pytest.raises(
        ValueError, match=r"unknown component 'leg'.* hand, mug_xy, mug_z, mug_from"
    ):
        pemirl_envs.get_task("sawyer_pusher/shift").components(["hand", "leg"])


def test_the_final_distance_is_horizontal_and_at_the_end():
    observation = torch.full((2, 5, 6), 9.0)
    observation[:, -1, 3:] = torch.tensor([[0.3, 0.4, 7.0], [1.0, 1.0, 7.0]])
    goal = torch.tensor([[0.0, 0.0], [1.0, 0.5]])
    distance = final_distance_to_goal(PARTS, "ball")(observation, {"goal": goal})
    torch.testing.assert_close(distance, torch.tensor([0.5, 0.5]))


# Results were measured, and models trained, on these: they may never change.
@pytest.mark.parametrize(
    ("domain", "indices", "key", "outcome", "planar"),
    [
        ("point_maze", [0, 1], "goal", "final_distance_m", True),
        ("ant", [13, 14], "direction", "speed_m_per_s", False),
        ("sweeper", [14, 15, 16, 17, 18, 19], "goal", "final_distance_m", False),
        ("sawyer_pusher", [3, 4], "goal", "final_distance_m", False),
    ],
)
def test_published_task_spaces(domain, indices, key, outcome, planar):
    for name in pemirl_envs.TASKS:
        if name.startswith(f"{domain}/"):
            task = pemirl_envs.get_task(name)
            assert task.task_space_indices() == indices
            assert (task.task_key, task.planar, list(task.outcomes)) == (key, planar, [outcome])


def test_components_come_in_the_order_of_their_names():
    task = pemirl_envs.get_task("sweeper/normal")
    assert task.components(["ball", "blade"]) == [17, 18, 19, 14, 15, 16]
    assert task.component_slice("joint_velocities") == slice(7, 14)
