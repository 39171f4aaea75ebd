"""A learned reward as LeRobot's reward models are asked: a dictionary of tensors in, ``[B]`` out.

The form is that of ``PreTrainedRewardModel.compute_reward(batch)`` in ``lerobot.rewards``: keys
such as ``observation.state`` to tensors whose first dimension is the batch, one reward for each.
LeRobot itself is not needed, nor imported.
"""

from __future__ import annotations

from collections.abc import Mapping

from torch import Tensor

from pemirl_trl.adapters.fixed_context import Context, FixedContext, Reward


class BatchReward:
    """r(s, m) of the states of a batch in LeRobot's form.

    The states are raw, in the units of the demonstrations: the reward has its own map of
    observations, so take the batch before a preprocessor that normalises it.

    Args:
        reward: a reward, a model that has one, or the file or the zoo's name of either.
        demonstration_or_m: one demonstration of the task, or m ``[D]``.
        state_key: where a batch has the state that the reward was learned on.

    Raises:
        ValueError, FileNotFoundError: as
            :class:`pemirl_trl.adapters.fixed_context.FixedContext`.

    Example:
        >>> import torch
        >>> from pemirl_trl import load_reward
        >>> reward = BatchReward(load_reward("point_maze"), [0.0, 0.0, 0.0])
        >>> reward.compute_reward({"observation.state": torch.zeros(8, 2)}).shape
        torch.Size([8])
    """

    def __init__(
        self,
        reward: Reward,
        demonstration_or_m: Context,
        *,
        state_key: str = "observation.state",
    ) -> None:
        self.state_key = state_key
        self._reward = FixedContext(reward, demonstration_or_m)

    def compute_reward(self, batch: Mapping[str, Tensor]) -> Tensor:
        """Return r ``[B]``, without a unit and without gradients.

        Args:
            batch: has the state ``[B, S]``; of a history ``[B, n, S]`` the last one counts, which
                is where LeRobot has the present.

        Raises:
            KeyError: the batch has no such state.
            ValueError: the state has another shape.
        """
        if self.state_key not in batch:
            raise KeyError(f"the batch has {sorted(batch)}; expected {self.state_key!r}")
        state = batch[self.state_key]
        if state.ndim not in (2, 3):
            raise ValueError(
                f"{self.state_key!r} has shape {list(state.shape)}; expected [B, S] or [B, n, S]"
            )
        return self._reward(state if state.ndim == 2 else state[:, -1])
