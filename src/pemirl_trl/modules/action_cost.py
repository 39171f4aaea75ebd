"""What somebody knows beside the learned reward: that actions cost."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey
from torch import Tensor

from pemirl_trl.modules.reading import read


class ActionCost(TensorDictModuleBase):
    """r(s, m) - c |a|^2: a learned reward of states, and the known price of acting.

    Reads what the reward reads, ``action`` ``[..., A]`` and, where present, ``absorbing``
    ``[...]``; writes ``learned_reward`` ``[..., 1]``. After an end nobody acts, and nothing is
    charged.

    Args:
        reward: writes ``learned_reward``.
        cost: c, in r's own units (it has none of the task's) per squared unit of an action.
        bounds: ``(low, high)`` ``[A]`` to which the environment clamps: what is beyond is not done.

    Raises:
        ValueError: a cost that is negative.

    Example:
        >>> from tensordict import TensorDict
        >>> from pemirl_trl import ShapedReward
        >>> reward = ShapedReward(observation_dim=4, context_dim=3)
        >>> costly = ActionCost(reward, 0.5, (-torch.ones(2), torch.ones(2)))
        >>> batch = TensorDict(
        ...     {
        ...         "observation": torch.randn(5, 4),
        ...         "context": torch.randn(5, 3),
        ...         "action": torch.full((5, 2), 9.0),
        ...     },
        ...     [5],
        ... )
        >>> free = reward(batch.copy())["learned_reward"]
        >>> bool((free - costly(batch)["learned_reward"] - 1.0).abs().max() < 1e-5)
        True
    """

    in_keys: list[NestedKey]
    out_keys: list[NestedKey]

    def __init__(
        self, reward: TensorDictModuleBase, cost: float, bounds: tuple[Tensor, Tensor]
    ) -> None:
        super().__init__()
        if not cost >= 0:
            raise ValueError(f"cost is {cost}; expected 0 or more")
        self.inner, self.cost, self.bounds = reward, cost, bounds
        states = [key for key in reward.in_keys if not (isinstance(key, tuple) and "next" in key)]
        self.in_keys, self.out_keys = [*states, "action"], ["learned_reward"]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Write the reward, less what the action costs, into ``tensordict``.

        Raises:
            MissingKeyError: the batch lacks what the reward reads, or the action.
        """
        action = read(tensordict, "action", "ActionCost")
        spent = squared_action(action, self.bounds, tensordict.get("absorbing", None))
        states = tensordict.select(*self.in_keys[:-1])
        reward = self.inner(states)["learned_reward"]
        return tensordict.set("learned_reward", reward - self.cost * spent)


def squared_action(
    action: Tensor, bounds: tuple[Tensor, Tensor], absorbing: Tensor | None = None
) -> Tensor:
    """|a|^2 of actions ``[..., A]`` as the environment clamps them, 0 after an end: ``[..., 1]``.

    Args:
        action: what was asked for.
        bounds: ``(low, high)`` ``[A]``.
        absorbing: ``[...]``, where a step begins after an end.
    """
    spent = action.clamp(*bounds).square().sum(-1, keepdim=True)
    return spent if absorbing is None else torch.where(absorbing.unsqueeze(-1), 0.0, spent)
