"""The ant's two mirror symmetries, with which one expert walks in up to four bodies.

The eyes are on one side, and weigh next to nothing: in the plane y = 0 the mirror image is not
exact. Demonstrations are therefore rolled out in the true body, by the mirrored policy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from pemirl_trl import ContextPolicy


@dataclass(frozen=True)
class Mirror:
    """A reflection: signs of vectors, and which leg comes to stand for which.

    Attributes:
        legs: index of the leg (0 to 3) whose image each leg is.
        ankle: sign of an ankle's angle; a hip's always flips.
        quaternion, velocity, angular: signs of (w, x, y, z), and of (x, y, z).
        direction: sign of the task.
    """

    legs: Sequence[int]
    ankle: float
    quaternion: Sequence[float]
    velocity: Sequence[float]
    angular: Sequence[float]
    direction: float

    def joints(self, values: Tensor) -> Tensor:
        """Of joint angles, their velocities or torques, ``[..., 8]``."""
        pairs = values.unflatten(-1, (4, 2))[..., list(self.legs), :]
        return (pairs * torch.tensor([-1.0, self.ankle])).flatten(-2)

    def observation(self, values: Tensor) -> Tensor:
        """Of observations ``[..., 27]``."""
        height, turn, angles, velocity, angular, speeds = values.split([1, 4, 8, 3, 3, 8], -1)
        parts = [
            height,
            turn * torch.tensor(self.quaternion),
            self.joints(angles),
            velocity * torch.tensor(self.velocity),
            angular * torch.tensor(self.angular),
            self.joints(speeds),
        ]
        return torch.cat(parts, -1)

    def disabled(self, legs: Sequence[int]) -> tuple[int, ...]:
        """The legs (1 to 4) that the mirrored body has disabled."""
        return tuple(sorted(self.legs.index(leg - 1) + 1 for leg in legs))


X = Mirror((1, 0, 3, 2), -1.0, (1, 1, -1, -1), (-1, 1, 1), (1, -1, -1), -1.0)
"""x -> -x: forward becomes backward."""
Y = Mirror((3, 2, 1, 0), 1.0, (1, -1, 1, -1), (1, -1, 1), (-1, 1, -1), 1.0)
"""y -> -y: front legs become hind legs."""


class MirroredPolicy:
    """An expert of one body, acting (with its noise) in the mirror image of that body."""

    def __init__(self, policy: ContextPolicy, mirrors: Sequence[Mirror]) -> None:
        self.policy, self.mirrors = policy, mirrors

    def __call__(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write ``action``."""
        observation, direction = tensordict["observation"], tensordict["task", "direction"]
        for mirror in self.mirrors:
            observation = mirror.observation(observation)
            direction = direction * mirror.direction
        batch = tensordict.batch_size
        task = TensorDict({"direction": direction}, batch)
        inputs = TensorDict({"observation": observation, "task": task}, batch)
        action = self.policy.get_dist(inputs).sample()
        for mirror in reversed(self.mirrors):
            action = mirror.joints(action)
        return tensordict.set("action", action)
