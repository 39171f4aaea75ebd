"""What a person would look at in a task's episodes, beside their return."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from tensordict import TensorDictBase
from torch import Tensor

Outcome = Callable[[Tensor, TensorDictBase], Tensor]
"""(observations ``[N, T, S]``, task parameters ``[N]``) -> ``[N]``"""


def _final_distance(columns: slice) -> Outcome:
    def outcome(observation: Tensor, tasks: TensorDictBase) -> Tensor:
        return (observation[:, -1, columns] - tasks["goal"]).norm(dim=-1)

    return outcome


def _speed(observation: Tensor, tasks: TensorDictBase) -> Tensor:
    return observation[..., 13].mean(-1) * tasks["direction"][:, 0]  # of the torso along x


OUTCOMES: Mapping[str, tuple[str, Outcome]] = {
    "point_maze": ("final_distance_m", _final_distance(slice(0, 2))),
    "ant": ("speed_m_per_s", _speed),
    "sweeper": ("final_distance_m", _final_distance(slice(17, 19))),
    "sawyer_pusher": ("final_distance_m", _final_distance(slice(3, 5))),
}
"""By task: a name with its unit, and the function."""
