"""Which of several bodies it is, told to the policy as part of the observation."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torchrl.data import Composite, TensorSpec, Unbounded
from torchrl.envs import Transform


class TellBody(Transform):
    """Appends which body an episode has to its observation: ``[N, S]`` -> ``[N, S + B]``.

    For demonstrations of one family of tasks by several bodies (robots, mechanisms, surroundings):
    whoever records them knows which body was recorded, a policy has to know it to move it, and a
    reward that is to hold in another body must not
    (``reward_features``: the first S components alone).

    Args:
        bodies: B, how many bodies were demonstrated.
        body_key: where the environment writes which one it is, one-hot ``[N, B]``. An environment
            that writes none is a new body: zeros.

    Raises:
        ValueError: on a call, the environment knows another number of bodies.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> seen = TensorDict({"observation": torch.ones(1, 3)}, [1])
        >>> TellBody(2)(seen)["observation"]
        tensor([[1., 1., 1., 0., 0.]])
    """

    def __init__(self, bodies: int, *, body_key: NestedKey = ("task", "body")) -> None:
        super().__init__(in_keys=[], out_keys=["observation"])
        self.bodies, self.body_key = bodies, body_key

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Append it to the observation of a stored batch, in place, and return it."""
        return self._call(tensordict)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        observation = next_tensordict.get("observation")
        body = next_tensordict.get(self.body_key, None)
        if body is None:
            body = observation.new_zeros(*observation.shape[:-1], self.bodies)
        elif body.shape[-1] != self.bodies:
            raise ValueError(
                f"the environment has {body.shape[-1]} bodies, TellBody was made for {self.bodies}"
            )
        told = torch.cat([observation, body.to(observation.dtype)], -1)
        return next_tensordict.set("observation", told)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        return self._call(next_tensordict)

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return self._call(tensordict_reset)

    def transform_observation_spec(self, observation_spec: TensorSpec) -> TensorSpec:
        """The environment's, with longer observations."""
        if not isinstance(observation_spec, Composite):
            raise TypeError(f"got {type(observation_spec).__name__}; expected a Composite")
        longer = observation_spec.clone()
        shape, dtype = longer["observation"].shape, longer["observation"].dtype
        longer["observation"] = Unbounded(
            (*shape[:-1], shape[-1] + self.bodies), dtype=dtype, device=observation_spec.device
        )
        return longer
