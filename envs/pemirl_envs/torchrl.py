"""The TorchRL face: N episodes of a task as one batched environment."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Bounded, Composite, Unbounded
from torchrl.envs import EnvBase

from pemirl_envs.episodes import Episodes
from pemirl_envs.simulation import Seed, SimulationError, generator_seed
from pemirl_envs.tasks import Task


class TaskEnv(EnvBase):
    """A task as a TorchRL environment of batch size ``[N]``, on the CPU.

    ==================== ============== ================================================
    key                  shape          meaning
    ==================== ============== ================================================
    observation          [N, S] float32 holds nothing of the task parameters
    ("task", name)       [N, ...]       ground-truth task parameters, for metrics alone
    action               [N, A] float32 clipped to its bounds; the data keep what was given
    reward               [N, 1] float32 r(s_t, a_t), for the clipped action
    truncated, done      [N, 1] bool    True after ``horizon`` steps
    terminated           [N, 1] bool    always False
    ==================== ============== ================================================

    ``reset`` takes ``("task", name)`` from its tensordict where that has them, and draws them from
    the split otherwise. With ``_reset``, the named simulations alone are reset, and they alone take
    given parameters. A ``TransformedEnv`` strips a reset's tensordict of all but ``_reset``:
    through one, say ``env.reset(task={"goal": goals})``.

    ``set_seed`` restarts the one stream from which everything random is drawn.
    The simulations live in native memory, so the environment cannot be pickled: give workers a
    factory, ``functools.partial(make, ...)``.

    A step in which some simulations fail raises :class:`~pemirl_envs.SimulationError`; the rows of
    the others are in its ``partial``, and after a reset of the failed ones the batch goes on::

        try:
            following = env.step(td)["next"]
        except SimulationError as error:
            following = error.partial
            failed = torch.zeros(env.batch_size, dtype=torch.bool)
            failed[error.indices] = True
            following = env.reset(following.exclude("reward").set("_reset", failed[:, None]))

    Args:
        task: the task.
        num_envs: the number of episodes, N.
        split: the set of tasks from which resets draw; default: ``task.default_split``.
        seed: seeds everything that is random; ``None`` takes one from the operating system. See
            :func:`~pemirl_envs.simulation.generator_seed` for what may be one.
        num_threads: threads that step the simulations. Default: one for each CPU in the affinity
            mask of the process. The results do not depend on it.

    Raises:
        TypeError: what is given as a seed is none.
        ValueError: unknown split, or a count that is not positive.
    """

    batch_locked = True

    def __init__(
        self,
        task: Task,
        num_envs: int,
        *,
        split: str | None = None,
        seed: Seed = None,
        num_threads: int | None = None,
    ) -> None:
        episodes = Episodes(task, num_envs, split=split, seed=seed, num_threads=num_threads)
        super().__init__(device=torch.device("cpu"), batch_size=torch.Size([num_envs]))
        self.episodes = episodes
        self._declare_specs()

    @property
    def task(self) -> Task:
        """The task of which these are episodes."""
        return self.episodes.task

    def _declare_specs(self) -> None:
        task, batch = self.task, self.batch_size
        low, high = (bound.expand(*batch, -1) for bound in task.action_bounds)
        self.action_spec = Bounded(low, high, dtype=torch.float32)
        parameters = {
            name: Bounded(
                low.float().expand(*batch, *low.shape),
                high.float().expand(*batch, *high.shape),
                dtype=torch.float32,
            )
            for name, (low, high) in task.parameter_bounds.items()
        }
        self.observation_spec = Composite(
            observation=Unbounded((*batch, task.observation_size), dtype=torch.float32),
            task=Composite(parameters, shape=batch),
            shape=batch,
        )
        self.reward_spec = Unbounded((*batch, 1), dtype=torch.float32)
        self.full_done_spec = Composite(
            {key: Binary(1, (*batch, 1), dtype=torch.bool) for key in self._done_values()},
            shape=batch,
        )

    def get_rng_state(self) -> Tensor:
        """The state of the random stream (uint8), for an exact resume at the next reset."""
        return self.episodes.generator.get_state()

    def set_rng_state(self, state: Tensor) -> None:
        """Restores a state of the random stream that ``get_rng_state`` returned."""
        self.episodes.generator.set_state(state)

    def physics_state(self) -> Tensor:
        """A copy of the full state of every simulation, float64 ``[N, n_state]``, for rendering."""
        return self.episodes.simulation.state

    def set_seed(self, seed: Seed = None, static_seed: bool = False) -> int | None:
        """Restarts the random stream; returns the seed for a next environment, as TorchRL does.

        Raises:
            TypeError, ValueError: it is no seed.
        """
        return super().set_seed(None if seed is None else generator_seed(seed), static_seed)

    def _set_seed(self, seed: int | None) -> None:
        self.episodes.seed(seed)

    def _reset(
        self,
        tensordict: TensorDictBase | None = None,
        task: Mapping[str, Tensor] | TensorDictBase | None = None,
        **kwargs: object,
    ) -> TensorDictBase:
        mask, parameters = None, task
        if tensordict is not None:
            mask = tensordict.get("_reset", None)
            parameters = tensordict.get("task", None) if task is None else task
        self.episodes.reset(
            None if mask is None else mask.view(self.batch_size),
            None if parameters is None else dict(parameters.items()),
        )
        return self._observed()

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        reward, failures = self.episodes.step(tensordict.get("action"))
        following = self._observed().set("reward", reward[:, None])
        if failures:
            raise SimulationError(failures, following)
        return following

    def _observed(self) -> TensorDict:
        values = {
            "observation": self.episodes.observe(),
            "task": {name: value.clone() for name, value in self.episodes.parameters.items()},
            **self._done_values(),
        }
        return TensorDict(values, batch_size=self.batch_size, device=self.device)

    def _done_values(self) -> dict[str, Tensor]:
        truncated = self.episodes.truncated()[:, None]
        return {
            "done": truncated,
            "terminated": torch.zeros_like(truncated),
            "truncated": truncated.clone(),
        }
