"""A task of one's own, as any TorchRL environment of fixed horizon: what own_task.py learns."""

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import Compose, EnvBase, StepCounter, Transform, TransformedEnv

from pemirl_trl import DemonstrationDataset, Provenance, SampleTasks
from pemirl_trl.evaluation import whole_episodes

T = 20  # steps of an episode


class Reach(EnvBase):
    """A point goes to a goal that it does not see; its steering may be reversed (-1)."""

    def __init__(self, n: int, steering: float) -> None:
        super().__init__(batch_size=[n])
        self.steering, task = steering, Composite(goal=Unbounded((n, 2)), shape=[n])
        self.observation_spec = Composite(observation=Unbounded((n, 2)), task=task, shape=[n])
        self.action_spec, self.reward_spec = Bounded(-1, 1, (n, 2)), Unbounded((n, 1))

    def _reset(self, td: TensorDictBase, **_: object) -> TensorDictBase:
        return td.select("task").set("observation", 0.1 * torch.randn(*self.batch_size, 2))

    def _step(self, td: TensorDictBase) -> TensorDictBase:
        position, action = td["observation"], td["action"].clamp(-1, 1)
        reward = -(position - td["task", "goal"]).norm(dim=-1, keepdim=True)  # a metric alone
        after = td.select("task").set("observation", position + 0.2 * self.steering * action)
        return after.set("reward", reward).set("done", torch.zeros_like(reward, dtype=torch.bool))

    def _set_seed(self, seed: int | None) -> None: ...


def environment(n: int, transform: Transform, steering: float = 1.0) -> EnvBase:
    """So many episodes of T steps, of what the transform writes at reset."""
    return TransformedEnv(Reach(n, steering), Compose(StepCounter(T), transform))


def demonstrations(n: int) -> DemonstrationDataset:
    """Of whoever knows the goal; the library reads the observations and actions alone."""

    def expert(td: TensorDictBase) -> TensorDictBase:
        way = 3 * (td["task", "goal"] - td["observation"])
        return td.set("action", way.clamp(-1, 1) + 0.1 * torch.randn_like(way))

    goals = SampleTasks(lambda n: TensorDict({"goal": 2 * torch.rand(n, 2) - 1}, [n]))
    return DemonstrationDataset.from_rollouts(
        whole_episodes(environment(n, goals), expert, T), Provenance()
    )
