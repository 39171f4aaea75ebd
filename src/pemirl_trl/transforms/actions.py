"""Discrete actions as one-hot vectors of real numbers."""

from __future__ import annotations

from typing import Self

import torch
from torch import Tensor
from torchrl.data import Categorical, Composite, OneHot, TensorSpec
from torchrl.envs import EnvBase, Transform


def is_choice(spec: TensorSpec) -> bool:
    """Whether a spec is of one choice of n; those of several are subclasses of these two."""
    return type(spec) in (OneHot, Categorical)


class OneHotActions(Transform):
    """Lets an environment of n discrete actions take them as vectors ``[..., n]`` of real numbers.

    That is how policies, encoders and discriminators of this library hold them, whether the
    environment itself takes TorchRL's one-hot vectors of integers or an index.

    Args:
        spec: of the environment's action, ``OneHot`` or ``Categorical``.

    Raises:
        TypeError: another spec.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> OneHotActions(Categorical(4)).inv(
        ...     TensorDict({"action": torch.tensor([0.0, 0.0, 1.0, 0.0])})
        ... )["action"]
        tensor(2)
    """

    def __init__(self, spec: TensorSpec) -> None:
        if not is_choice(spec):
            raise TypeError(
                f"got an action spec {type(spec).__name__}; expected OneHot or Categorical"
            )
        super().__init__(in_keys_inv=["action"], out_keys_inv=["action"])
        self._index = isinstance(spec, Categorical)
        self._n, self._dtype = int(spec.space.n), spec.dtype

    @classmethod
    def of(cls, env: EnvBase) -> Self | None:
        """The transform that an environment needs; None where its actions are not discrete."""
        spec = env.action_spec
        return cls(spec) if is_choice(spec) else None

    def _inv_apply_transform(self, action: Tensor) -> Tensor:
        index = action.argmax(-1)
        if not self._index:
            index = torch.nn.functional.one_hot(index, self._n)
        return index.to(self._dtype)

    def transform_action_spec(self, action_spec: TensorSpec) -> TensorSpec:
        """The spec that is seen from outside: ``OneHot`` of torch's default dtype."""
        if isinstance(action_spec, Composite):
            outside = action_spec.clone()
            outside["action"] = self.transform_action_spec(outside["action"])
            return outside
        shape = action_spec.shape if self._index else action_spec.shape[:-1]
        return OneHot(
            self._n,
            shape=(*shape, self._n),
            dtype=torch.get_default_dtype(),
            device=action_spec.device,
        )
