"""A grid of cells, to be crossed to a goal that is not observed; batched in torch."""

from __future__ import annotations

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Categorical, Composite, Unbounded
from torchrl.envs import EnvBase

from pemirl_trl import DemonstrationDataset, Provenance

T = 40  # steps of an episode
SIZE = 11  # cells a side
MOVES = torch.tensor([[0, 1], [0, -1], [-1, 0], [1, 0], [0, 0]])  # up, down, left, right, stay
KEYS = ("column", "row")  # what is observed, in the order of the demonstrations


class Grid(EnvBase):
    """Observes its column and its row, each in [-1, 1]; takes one of five moves, turned by keys=-1.

    It may be reset to ("task", "goal"), a cell; its reward, which no learner reads, is minus the
    distance to that, in cells.
    """

    def __init__(self, n: int, seed: int, keys: int = 1) -> None:
        super().__init__(batch_size=[n])
        self.keys, self.generator = keys, torch.Generator().manual_seed(seed)
        seen = {key: Unbounded((n, 1)) for key in KEYS}
        task = Composite(goal=Unbounded((n, 2)), shape=[n])
        self.observation_spec = Composite(**seen, task=task, shape=[n])
        self.action_spec = Categorical(len(MOVES), shape=(n,))
        self.reward_spec = Unbounded((n, 1))

    def _reset(self, td: TensorDictBase | None, **_: object) -> TensorDictBase:
        drawn = torch.randint(SIZE, (self.batch_size[0], 4), generator=self.generator)
        self.cell, goal = drawn[:, :2], None if td is None else td.get(("task", "goal"), None)
        self.goal = drawn[:, 2:].float() if goal is None else goal.clone()
        return self._observed()

    def _step(self, td: TensorDictBase) -> TensorDictBase:
        reward = true_reward(observation(self.cell), self.goal)
        self.cell = (self.cell + self.keys * MOVES[td["action"]]).clamp(0, SIZE - 1)
        return self._observed().update(
            {"reward": reward, "done": torch.zeros_like(reward, dtype=torch.bool)}
        )

    def _observed(self) -> TensorDictBase:
        entries = dict(zip(KEYS, observation(self.cell).split(1, -1), strict=True))
        task = TensorDict({"goal": self.goal.clone()}, self.batch_size)
        return TensorDict({**entries, "task": task}, self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        self.generator.manual_seed(0 if seed is None else seed)


def observation(cell: Tensor) -> Tensor:
    """Cells ``[..., 2]`` in [-1, 1]."""
    return 2.0 * cell / (SIZE - 1) - 1.0


def place(observation: Tensor) -> Tensor:
    """The cells ``[..., 2]`` of observations, as real numbers."""
    return (observation + 1.0) * (SIZE - 1) / 2


def true_reward(observation: Tensor, goal: Tensor) -> Tensor:
    """The reward ``[..., 1]``, of the step's start: minus the distance, in cells."""
    return -(place(observation) - goal).norm(dim=-1, keepdim=True)


def controller(observation: Tensor, goal: Tensor, keys: int = 1) -> Tensor:
    """The move ``[N]`` of whoever knows the goal: along the larger distance, and then it stays."""
    after = place(observation).unsqueeze(-2) + keys * MOVES  # [N, 5, 2]
    return (after - goal.unsqueeze(-2)).norm(dim=-1).argmin(-1)


def make(num_envs: int, seed: int) -> EnvBase:
    """The environment of the demonstrations."""
    return Grid(num_envs, seed)


def make_turned(num_envs: int, seed: int) -> EnvBase:
    """The same with every move turned around: up is down, left is right."""
    return Grid(num_envs, seed, keys=-1)


def demonstrations(n: int, seed: int) -> DemonstrationDataset:
    """One demonstration of each of so many goals; one move in ten is drawn uniformly."""
    env, generator = Grid(n, seed), torch.Generator().manual_seed(seed + 1)

    def act(td: TensorDictBase) -> TensorDictBase:
        move = controller(torch.cat([td[key] for key in KEYS], -1), td["task", "goal"])
        uniform = torch.randint(len(MOVES), move.shape, generator=generator)
        strays = torch.rand(move.shape, generator=generator) < 0.1
        return td.set("action", torch.where(strays, uniform, move))

    rollouts = env.rollout(T, act)
    episodes = [
        ({key: torch.cat([row[key], row["next", key][-1:]]) for key in KEYS}, row["action"])
        for row in rollouts
    ]
    return DemonstrationDataset.from_episodes(
        episodes,
        Provenance("own_grid", seed),
        {"goal": rollouts["task", "goal"][:, 0]},
        discrete_actions=len(MOVES),
        observation_keys=KEYS,
    )
