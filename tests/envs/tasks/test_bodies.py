"""Episodes of several bodies in one batch are those of each body by itself."""

import pytest
import torch
from tensordict import TensorDict

from pemirl_envs import SeveralBodies, TaskEnv
from pemirl_envs.tasks.ant import Ant
from pemirl_envs.tasks.sawyer_pusher import SawyerPusher

BODIES = [Ant(), Ant(disabled=(2, 3)), Ant(disabled=True)]


class SeveralAnts(SeveralBodies, Ant):
    def __init__(self, bodies=BODIES):
        Ant.__init__(self)
        self.use_bodies(bodies)


class SeveralWalls(SeveralBodies, SawyerPusher):
    def __init__(self, bodies):
        SawyerPusher.__init__(self)
        self.use_bodies(bodies)


def rollout(task, parameters, start, actions):
    """Observations and rewards of episodes that all begin in the same state."""
    env = TaskEnv(task, len(parameters), seed=3, num_threads=1)
    data, seen = env.reset(task=parameters), []
    start = {
        name: torch.as_tensor(value).expand(len(parameters), -1) for name, value in start.items()
    }
    env.episodes.simulation.write(start)
    for action in actions:
        data = env.step(data.set("action", action))["next"]
        seen.append(torch.cat([data["observation"], data["reward"]], -1))
        data = data.exclude("reward")
    return torch.stack(seen, 1)


def test_every_row_moves_as_its_body_does():
    tasks = TensorDict(SeveralAnts().task_set("train"), [6])
    assert tasks["body"].argmax(-1).tolist() == [0, 1, 2, 0, 1, 2]
    assert tasks["direction"][:, 0].tolist() == [1, 1, 1, -1, -1, -1]
    actions = 2 * torch.rand(20, 6, 8, generator=torch.Generator().manual_seed(0)) - 1
    task = SeveralAnts()
    start = {"qpos": Ant().model.qpos0, "qvel": torch.zeros(14)}
    together = rollout(task, tasks, start, actions)
    for i, body in enumerate(BODIES):
        alone = rollout(body, tasks.exclude("body"), start, actions)
        rows = tasks["body"].argmax(-1) == i
        assert torch.equal(together[rows], alone[rows])
        assert not torch.equal(together[~rows], alone[~rows])


def test_a_masked_reset_changes_the_bodies_of_its_rows_alone():
    env = TaskEnv(SeveralAnts(), 2, seed=0, num_threads=1)
    eye = torch.eye(3)
    forward = torch.ones(2, 1)
    env.reset(task=TensorDict({"direction": forward, "body": eye[:2]}, [2]))
    task = {"direction": forward, "body": eye[[2, 2]]}
    env.reset(TensorDict({"_reset": torch.tensor([[True], [False]]), "task": task}, [2]))
    assert env.episodes.parameters["body"].argmax(-1).tolist() == [2, 1]


def test_draws_have_every_body_and_the_expert_reads_the_task():
    task = SeveralAnts()
    drawn = task.sample_parameters(600, "train", torch.Generator().manual_seed(0))
    counts = drawn["body"].sum(0)
    assert counts.sum() == 600
    assert (counts > 150).all()
    assert task.task_key == "direction"
    assert drawn.keys() == task.parameter_bounds.keys() == {"direction", "body"}


def test_bodies_of_other_sizes_are_refused():
    with pytest.raises(ValueError, match=r"body 1 has a model of sizes .*'ngeom'"):
        SeveralWalls([SawyerPusher(), SawyerPusher(0.1)])
    with pytest.raises(ValueError, match="got no body"):
        SeveralAnts([])
