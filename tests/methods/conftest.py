"""Two small problems for the methods: a toy of ten steps, and Point-Maze."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase, TransformedEnv

import pemirl_envs
from pemirl_trl import DemonstrationDataset, InferContext, ModelConfig, PEMIRLModel, Standardize
from pemirl_trl import meta_train as meta_train_in_one_call
from pemirl_trl.methods import (
    AIRL,
    PEMIRL,
    AIRLConfig,
    BatchConfig,
    MetaInfoGAIL,
    MetaInfoGAILConfig,
    PEMIRLConfig,
    PolicyOptimization,
    PolicyOptimizationConfig,
)


class Reach(EnvBase):
    """A point on a line walks to its goal, ten steps of at most 0.25 m; r = -|x - goal|.

    Draws from torch's global generator, as an environment without a stream of its own may.
    """

    batch_locked = True
    horizon = 10
    step_size = 0.25

    def __init__(self, num_envs: int) -> None:
        super().__init__(device=torch.device("cpu"), batch_size=[num_envs])
        one = (num_envs, 1)
        goal = Composite(goal=Unbounded(one), shape=[num_envs])
        self.observation_spec = Composite(observation=Unbounded(one), task=goal, shape=[num_envs])
        self.action_spec = Bounded(-torch.ones(one), torch.ones(one))
        self.reward_spec = Unbounded(one)
        self.full_done_spec = Composite(
            {key: Binary(1, one, dtype=torch.bool) for key in ("done", "terminated", "truncated")},
            shape=[num_envs],
        )

    def _set_seed(self, seed: int | None) -> None:
        torch.manual_seed(0 if seed is None else seed)

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDictBase:
        given = None if tensordict is None else tensordict.get(("task", "goal"), None)
        shape = (*self.batch_size, 1)
        self.goal = 2.0 * torch.rand(shape) - 1.0 if given is None else given.clone()
        self.position = 0.1 * torch.randn(shape)
        self.time = 0
        return self._observed()

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        reward = -(self.position - self.goal).abs()
        self.position = self.position + self.step_size * tensordict["action"].clamp(-1.0, 1.0)
        self.time += 1
        return self._observed().set("reward", reward)

    def _observed(self) -> TensorDict:
        end = torch.full((*self.batch_size, 1), self.time >= self.horizon)
        return TensorDict(
            {
                "observation": self.position.clone(),
                "task": {"goal": self.goal.clone()},
                "done": end,
                "terminated": torch.zeros_like(end),
                "truncated": end.clone(),
            },
            self.batch_size,
        )


def reach_expert(position: Tensor, goal: Tensor) -> Tensor:
    """The optimal action of :class:`Reach`: straight to the goal, and stay."""
    return (goal - position) / Reach.step_size


def maze_expert(position: Tensor, goal: Tensor) -> Tensor:
    """A hand-written controller of ``point_maze/left``: through the gap, then to the goal."""
    gap = torch.tensor([0.5, 0.37]).expand_as(goal)
    return 6.0 * (torch.where(position[:, 1:] < 0.32, gap, goal) - position)


@dataclass
class Problem:
    """What the tests build methods from; every builder starts from a seed.

    Attributes:
        make: number of environments -> environment.
        demonstrations, tasks: of the expert, batch size ``[J]``.
    """

    make: Callable[..., EnvBase]
    demonstrations: TensorDict
    tasks: TensorDict

    @property
    def horizon(self) -> int:
        return self.demonstrations["action"].shape[1]

    def model(self, seed: int = 0, **sizes: Any) -> PEMIRLModel:
        torch.manual_seed(seed)
        observation = self.demonstrations["observation"]
        return PEMIRLModel(
            observation.shape[-1],
            self.demonstrations["action"].shape[-1],
            self.horizon,
            ModelConfig(**sizes),
            Standardize.fit(observation),
        )

    def env(
        self, model: PEMIRLModel, contexts: int, rollouts: int, tasks: Any = None, **options: Any
    ) -> EnvBase:
        """An environment that draws ``contexts`` demonstrations, ``rollouts`` rollouts each."""
        transform = InferContext(
            model.encoder,
            self.demonstrations,
            rollouts_per_context=rollouts,
            tasks=self.tasks if tasks is None else tasks,
        )
        return TransformedEnv(self.make(contexts * rollouts, **options), transform)

    def pemirl(self, seed: int = 0, *, model: PEMIRLModel | None = None, **options: Any) -> PEMIRL:
        """Meta-training; see :meth:`_adversarial`."""
        options = {"info_contexts": 4, **options}
        return self._adversarial(PEMIRL, PEMIRLConfig, model or self.model(seed), **options)

    def airl(self, seed: int = 0, *, model: PEMIRLModel | None = None, **options: Any) -> AIRL:
        """Adversarial IRL on the contexts of an encoder that is not trained."""
        return self._adversarial(AIRL, AIRLConfig, model or self.model(seed), **options)

    def meta_infogail(
        self, seed: int = 0, *, model: PEMIRLModel | None = None, **options: Any
    ) -> MetaInfoGAIL:
        """The baseline, from an encoder and a policy that know nothing."""
        model = model or self.model(seed, reward="gail")
        options = {"info_contexts": 4, **options}
        return self._adversarial(MetaInfoGAIL, MetaInfoGAILConfig, model, **options)

    def _adversarial(
        self,
        method: type,
        config_type: type,
        model: PEMIRLModel,
        *,
        contexts: int = 4,
        tasks: Any = None,
        env: dict[str, Any] | None = None,
        **config: Any,
    ) -> Any:
        """Two rollouts per context, batches of 16 + 16 trajectories."""
        defaults = {
            "rollouts_per_context": 2,
            "batch": BatchConfig(trajectories=16, time_steps=5),
        }
        config = config_type(**{**defaults, **config})
        wrapped = self.env(model, contexts, config.rollouts_per_context, tasks, **(env or {}))
        return method(model, wrapped, self.demonstrations, config)

    def policy_optimization(
        self, seed: int = 0, *, learned: bool = False, **config: Any
    ) -> PolicyOptimization:
        """A policy from ``seed``, on contexts and (if ``learned``) the reward of model 0."""
        frozen, policy = self.model(0), self.model(seed).policy
        return PolicyOptimization(
            self.env(frozen, 4, 2),
            policy,
            self.horizon,
            PolicyOptimizationConfig(**config),
            rollouts_per_context=2,
            reward=frozen.reward if learned else None,
        )


def _problem(
    make: Callable[..., EnvBase],
    expert: Callable[[Tensor, Tensor], Tensor],
    goals: Tensor,
    horizon: int,
    noise: float = 0.05,
) -> Problem:
    """A problem with one demonstration per goal; ``noise`` is the deviation of its actions."""
    tasks = TensorDict({"goal": goals}, [len(goals)])
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        env, steps = make(len(goals)), []
        data = env.reset(TensorDict({"task": tasks}, env.batch_size))
        for _ in range(horizon):
            action = expert(data["observation"], goals).clamp(-1.0, 1.0)
            data["action"] = action + noise * torch.randn_like(action)
            data = env.step(data)
            steps.append(data.select("observation", "action", ("next", "observation")))
            data = data["next"].exclude("reward")
    demonstrations = torch.stack(steps, 1)
    demonstrations.batch_size = [len(goals)]  # an encoder reduces time
    return Problem(make, demonstrations, tasks)


def reach_problem(goals: Tensor, noise: float = 0.05) -> Problem:
    """The toy with demonstrations of these goals ``[J, 1]``."""
    return _problem(Reach, reach_expert, goals, Reach.horizon, noise)


def maze_problem() -> Problem:
    """Point-Maze with 8 demonstrations."""

    def make(num_envs: int, num_threads: int = 1, seed: int = 0) -> EnvBase:
        return pemirl_envs.make("point_maze/left", num_envs, seed=seed, num_threads=num_threads)

    goals = pemirl_envs.task_parameters("point_maze/left", "test")["goal"][:8]
    return _problem(make, maze_expert, goals, horizon=100)


@pytest.fixture(scope="session")
def make_reach() -> Callable[..., Problem]:
    return reach_problem


@pytest.fixture(scope="session")
def reach() -> Problem:
    """The toy with 12 demonstrations."""
    return reach_problem(torch.linspace(-1.0, 1.0, 12).unsqueeze(-1))


def reach_dataset(goals: Tensor) -> DemonstrationDataset:
    """Demonstrations of these goals ``[J, 1]``, as a user has them: without tasks."""
    pile = reach_problem(goals).demonstrations
    observation = torch.cat([pile["observation"], pile["next", "observation"][:, -1:]], 1)
    return DemonstrationDataset(observation, pile["action"])


class ReversedReach(Reach):
    """Steering is reversed."""

    step_size = -0.25


@pytest.fixture(scope="session")
def dataset() -> Callable[[Tensor], DemonstrationDataset]:
    return reach_dataset


@pytest.fixture(scope="session")
def make_env() -> Callable[[int, int], EnvBase]:
    """What a user writes: the environment of the demonstrations."""
    return lambda num_envs, seed: Reach(num_envs)


@pytest.fixture(scope="session")
def make_reversed() -> Callable[[int, int], EnvBase]:
    """The same where steering is reversed."""
    return lambda num_envs, seed: ReversedReach(num_envs)


FEW: dict[str, Any] = {
    "model": {"context_dim": 2},
    "meta_il": {"steps": 600},
    "contexts_per_batch": 20,
    "training": {"iterations": 40, "rollouts_per_context": 4},
}
"""Settings of a meta-training of seconds."""


@pytest.fixture(scope="session")
def few() -> dict[str, Any]:
    return FEW


@pytest.fixture(scope="session")
def trained(make_env) -> PEMIRLModel:
    """A model meta-trained on 60 goals in [-1, 1]; leave it as it is."""
    with torch.random.fork_rng(devices=[]):
        goals = torch.linspace(-1.0, 1.0, 60).unsqueeze(-1)
        return meta_train_in_one_call(make_env, reach_dataset(goals), **FEW)


@pytest.fixture(scope="session")
def maze() -> Problem:
    return maze_problem()


def _flatten(value: Any, prefix: str, flat: dict[str, Tensor]) -> None:
    if isinstance(value, dict):
        for key, item in value.items():
            _flatten(item, f"{prefix}.{key}", flat)
    elif isinstance(value, (list, tuple)):
        _flatten(dict(enumerate(value)), prefix, flat)
    else:
        flat[prefix] = value.clone() if isinstance(value, Tensor) else value


@pytest.fixture(scope="session")
def state() -> Callable[[Any], dict[str, Any]]:
    """A copy of all that a method's checkpoint would hold, as one flat dictionary."""

    def read(method: Any) -> dict[str, Any]:
        flat: dict[str, Any] = {}
        for name, component in method.components().items():
            _flatten(component.state_dict(), name, flat)
        return flat

    return read


@pytest.fixture(scope="session")
def differences() -> Callable[[dict, dict], list[str]]:
    """The names under which two such dictionaries differ by as much as a bit."""

    def compare(a: dict[str, Any], b: dict[str, Any]) -> list[str]:
        def equal(x: Any, y: Any) -> bool:
            both = isinstance(x, Tensor) and isinstance(y, Tensor)
            return torch.equal(x, y) if both else type(x) is type(y) and x == y

        return sorted(a.keys() ^ b.keys()) + [
            k for k in a.keys() & b.keys() if not equal(a[k], b[k])
        ]

    return compare
