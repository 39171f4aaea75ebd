"""One task in several bodies, told apart from episode to episode."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import torch
from torch import Generator, Tensor

from pemirl_envs.tasks.base import Task
from pemirl_envs.tasks.quantities import Parameters


class SeveralBodies(Task):
    """Makes a task's dynamics a parameter of the episode: ``body``, one-hot, float32 ``[N, B]``.

    To be mixed into the task whose parameters, observation and reward all bodies share, and which
    depend on no body::

        class SeveralAnts(SeveralBodies, Ant):
            def __init__(self) -> None:
                Ant.__init__(self)
                self.use_bodies([Ant(), Ant(disabled=(2, 3))])

    An observation holds nothing of the body, as it holds nothing of the other parameters;
    :class:`pemirl_trl.TellBody` tells it. The finite splits hold every task in every body, the
    bodies of a task in a row. The parameter that an expert reads is the task's own.
    """

    def use_bodies(self, bodies: Sequence[Task]) -> None:
        """Say which bodies there are: variants of the task, whose models have the same sizes.

        Raises:
            ValueError: there is none, or their models differ in size; names the body.
        """
        if not bodies:
            raise ValueError("got no body; expected one or more")
        first = bodies[0].model
        for i, body in enumerate(bodies):
            sizes = {
                name: getattr(body.model, name) for name in ("nq", "nv", "nu", "nbody", "ngeom")
            }
            wanted = {name: getattr(first, name) for name in sizes}
            if sizes != wanted:
                raise ValueError(f"body {i} has a model of sizes {sizes}; body 0 has {wanted}")
        self._own_key = self.task_key
        self._bodies = list(bodies)
        bounds = (torch.zeros(len(bodies)), torch.ones(len(bodies)))
        self.parameter_bounds = {**self.parameter_bounds, "body": bounds}

    @property
    def task_key(self) -> str:
        """The parameter that an expert reads; see :class:`Task`."""
        return getattr(self, "_own_key", None) or super().task_key

    def build_spec(self) -> mujoco.MjSpec:
        """The model of the first body."""
        return self._bodies[0].build_spec()

    def models(self, parameters: Parameters) -> list[mujoco.MjModel]:
        """The body of each episode."""
        return [self._bodies[i].model for i in parameters["body"].argmax(-1).tolist()]

    def task_set(self, split: str) -> dict[str, Tensor]:
        """All tasks of a finite split in every body: ``[K B, ...]``, and ``body`` ``[K B, B]``."""
        own, count = super().task_set(split), len(self._bodies)  # type: ignore[safe-super]
        tasks = {name: value.repeat_interleave(count, 0) for name, value in own.items()}
        rows = len(next(iter(tasks.values())))
        return {**tasks, "body": torch.eye(count).repeat(rows // count, 1)}

    def sample_parameters(self, n: int, split: str, generator: Generator) -> dict[str, Tensor]:
        """Draws ``n`` tasks, each in a body drawn uniformly."""
        drawn = super().sample_parameters(n, split, generator)  # type: ignore[safe-super]
        body = torch.randint(len(self._bodies), (n,), generator=generator)
        return {**drawn, "body": torch.eye(len(self._bodies))[body]}
