"""The learned reward in the place of the environment's own."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey
from torchrl.data import Composite
from torchrl.envs import Transform

from pemirl_trl.modules.reading import read


class LearnedReward(Transform):
    """Replace the reward by the learned one, on a live environment or on a stored batch.

    The environment's own reward moves to ``("next", true_key)``, as a metric. The learned one is a
    function of the step's start, r(s_t, m) or f(s_t, a_t, s_{t+1}, m).

    Training is better served by one call on the whole batch (``transform(batch)``) than by one per
    step of the environment.

    Args:
        reward: reads ``observation``, ``context`` and, where it needs it, ``("next",
            "observation")``; writes ``reward_key``. Run without gradients.
        reward_key: what it writes: ``"learned_reward"`` or ``"shaped_reward"``; of
            :class:`pemirl_trl.ShapedReward` the ``reward_key`` or the ``shaped_reward_key``.
        true_key: where the environment's reward goes.

    Raises:
        TypeError: the reward is no TensorDict module.
        ValueError: it does not write ``reward_key``.
        MissingKeyError: on a call, the batch lacks what it reads.

    Example:
        >>> from tensordict import TensorDict
        >>> from pemirl_trl import ShapedReward
        >>> batch = TensorDict(
        ...     {
        ...         "observation": torch.randn(4, 10, 6),
        ...         "context": torch.randn(4, 10, 3),
        ...         "next": {"observation": torch.randn(4, 10, 6), "reward": torch.ones(4, 10, 1)},
        ...     },
        ...     [4, 10],
        ... )
        >>> batch = LearnedReward(ShapedReward(observation_dim=6, context_dim=3))(batch)
        >>> batch["next", "reward"].shape, batch["next", "true_reward"].mean().item()
        (torch.Size([4, 10, 1]), 1.0)
    """

    def __init__(
        self,
        reward: TensorDictModuleBase,
        reward_key: NestedKey = "learned_reward",
        true_key: str = "true_reward",
    ) -> None:
        if not isinstance(reward, TensorDictModuleBase):
            raise TypeError(
                f"LearnedReward takes a TensorDict module, got {type(reward).__name__}"
                + (": pass its .reward" if hasattr(reward, "reward") else "")
            )
        if reward_key not in reward.out_keys:
            raise ValueError(
                f"unknown reward key {reward_key!r}; this reward writes {reward.out_keys}"
            )
        super().__init__(in_keys=[], out_keys=["reward", true_key])
        self.reward, self.reward_key, self.true_key = reward, reward_key, true_key

    @torch.no_grad()
    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        here = [k for k in self.reward.in_keys if not (isinstance(k, tuple) and k[0] == "next")]
        for key in here:
            read(tensordict, key, "LearnedReward")
        inputs = tensordict.select(*here).set("next", next_tensordict.copy())
        learned = self.reward(inputs).get(self.reward_key)
        if next_tensordict.get(self.true_key, None) is None:  # a batch may be scored again
            next_tensordict.set(self.true_key, next_tensordict.get("reward"))
        return next_tensordict.set("reward", learned)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Replace ``("next", "reward")`` of a stored batch ``[...]``, in place, and return it.

        A reward is of single transitions: the batch may be flat.

        Raises:
            MissingKeyError: the batch lacks the environment's reward or what the reward reads.
        """
        read(tensordict, ("next", "reward"), "LearnedReward")
        self._step(tensordict, tensordict.get("next"))
        return tensordict

    def transform_reward_spec(self, reward_spec: Composite) -> Composite:
        """Add the true reward beside the learned one."""
        reward_spec[self.true_key] = reward_spec["reward"].clone()
        return reward_spec
