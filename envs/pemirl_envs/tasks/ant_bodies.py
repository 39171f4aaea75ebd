"""Ant with several bodies: which legs are disabled is a parameter of the episode."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mujoco
import torch
from torch import Generator, Tensor

from pemirl_envs.tasks.ant import Ant, disable
from pemirl_envs.tasks.base import Parameters

LEGS = 4
# In the order in which they join: the first n are a family of n bodies. The ant of `ant/disabled`,
# legs 3 and 4, is none of them.
BODIES: tuple[tuple[int, ...], ...] = ((), (2, 3), (1, 3), (2,), (1, 4), (2, 4), (4,), (1, 2))


class AntBodies(Ant):
    """An ant whose disabled legs differ from episode to episode.

    Task parameters: ``direction``, float32 ``[N, 1]``, as of :class:`Ant`, and ``disabled``,
    float32 ``[N, 4]``: 1 for each leg that is disabled, 0 for a healthy one. The reward does not
    depend on the latter, and no observation holds it.

    Args:
        bodies: the legs (1 to 4) that each body has disabled; the first is the model's own.
    """

    task_key = "direction"

    def __init__(self, bodies: Sequence[Sequence[int]] = BODIES) -> None:
        super().__init__()
        self._bodies = torch.zeros(len(bodies), LEGS)
        for row, legs in zip(self._bodies, bodies, strict=True):
            row[[leg - 1 for leg in legs]] = 1.0
        self._models = [self._compile(legs) for legs in bodies]
        bounds = (torch.zeros(LEGS), torch.ones(LEGS))
        self.parameter_bounds = {**self.parameter_bounds, "disabled": bounds}

    @staticmethod
    def _compile(legs: Sequence[int]) -> mujoco.MjModel:
        spec = Ant().build_spec()
        for leg in legs:
            disable(spec, leg)
        return spec.compile()

    def models(self, parameters: Parameters) -> list[mujoco.MjModel]:
        """The body of each episode."""
        return [self._models[i] for i in self._body(parameters["disabled"]).tolist()]

    def _body(self, disabled: Tensor) -> Tensor:
        return (disabled.unsqueeze(1) == self._bodies).all(-1).int().argmax(-1)

    def task_set(self, split: str) -> dict[str, Tensor]:
        """Both directions with every body, bodies in a row: ``[2 B, 1]`` and ``[2 B, 4]``."""
        directions = super().task_set(split)["direction"]
        return {
            "direction": directions.repeat_interleave(len(self._bodies), 0),
            "disabled": self._bodies.repeat(len(directions), 1),
        }

    def sample_parameters(self, n: int, split: str, generator: Generator) -> dict[str, Tensor]:
        """Draws ``n`` directions and bodies, each uniformly."""
        drawn = super().sample_parameters(n, split, generator)
        body = torch.randint(len(self._bodies), (n,), generator=generator)
        return {**drawn, "disabled": self._bodies[body]}


VARIANTS: dict[str, Callable[[], Ant]] = {}
