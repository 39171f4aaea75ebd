"""The average of the reward's weights over the last iterations, in the place of the last ones."""

from __future__ import annotations

from typing import Any

from torch.optim.swa_utils import AveragedModel, get_ema_multi_avg_fn

from pemirl_trl.methods.loop import Method, Metrics
from pemirl_trl.modules import PEMIRLModel


class AveragedReward:
    """A method whose model ends with an exponential average of its reward's weights.

    The average takes one snapshot per iteration and never enters the training; the model gets it
    at the last iteration. (Polyak averaging.)

    Args:
        method: trains ``model``.
        model: its reward is averaged.
        decay: of the average, per iteration.
    """

    def __init__(self, method: Method, model: PEMIRLModel, decay: float) -> None:
        if not 0 < decay < 1:
            raise ValueError(f"decay is {decay}; expected a number between 0 and 1")
        self.method, self.model = method, model
        self.iterations = method.iterations
        self._average = AveragedModel(model.reward, multi_avg_fn=get_ema_multi_avg_fn(decay))
        self._done = 0

    @property
    def env_steps(self) -> int:
        """Environment steps so far."""
        return self.method.env_steps

    def iteration(self) -> Metrics:
        """One iteration of the method, and one snapshot."""
        metrics = self.method.iteration()
        self._average.update_parameters(self.model.reward)
        self._done += 1
        if self._done == self.iterations:
            self.model.reward.load_state_dict(self._average.module.state_dict())
        return metrics

    def components(self) -> dict[str, Any]:
        """What a checkpoint holds."""
        return {**self.method.components(), "average": self._average, "averaging": self}

    def state_dict(self) -> dict[str, Any]:
        """Counters of the run."""
        return {"done": self._done}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Continue a run."""
        self._done = int(state["done"])
