"""Reset an environment to chosen tasks, several rollouts each."""

from __future__ import annotations

from collections.abc import Callable

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import Transform


class SampleTasks(Transform):
    """Reset to tasks of one's choice, K environments in a row to each.

    For training on the true reward, where the task is known: an expert, or an oracle to compare
    with. Every full or masked reset draws anew.

    Args:
        tasks: count -> task parameters with batch size ``[count]``; called at each reset.
        rollouts_per_task: K.
        task_key: where the environment reads them at reset.

    Raises:
        ValueError: at reset, environments that do not divide into K rollouts per task.
    """

    def __init__(
        self,
        tasks: Callable[[int], TensorDictBase],
        *,
        rollouts_per_task: int = 1,
        task_key: str = "task",
    ) -> None:
        super().__init__(in_keys=[], out_keys=[])
        self.tasks, self.rollouts_per_task, self.task_key = tasks, rollouts_per_task, task_key

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase:
        """Draw before the environment resets."""
        rollouts = self.parent.batch_size.numel()
        count, rest = divmod(rollouts, self.rollouts_per_task)
        if rest:
            raise ValueError(
                f"{rollouts} environments do not divide into {self.rollouts_per_task} rollouts "
                "per task"
            )
        index = torch.arange(count).repeat_interleave(self.rollouts_per_task)
        if tensordict is None:
            tensordict = TensorDict({}, self.parent.batch_size)
        return tensordict.copy().set(self.task_key, self.tasks(count)[index])
