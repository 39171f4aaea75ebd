"""A reward whose context is settled: by a demonstration, or given."""

from __future__ import annotations

import warnings
from pathlib import Path

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from pemirl_trl.data import DemonstrationDataset
from pemirl_trl.methods.inference import infer
from pemirl_trl.modules import PEMIRLModel
from pemirl_trl.modules.family import FAR
from pemirl_trl.sharing import PortableReward, load_reward

Reward = PortableReward | PEMIRLModel | str | Path
"""What is asked: a reward, a model that has one, or the file or the zoo's name of either."""
Context = DemonstrationDataset | Tensor | ArrayLike
"""A demonstration, of which m is inferred, or m itself: numbers ``[D]``."""


class FarFromTraining(UserWarning):
    """A reward is asked where it was not trained: what it says there may mean nothing."""


class FixedContext:
    """r(s, m) of raw states, with one m, which says once where it is asked too far out.

    Args:
        reward: see :data:`Reward`.
        demonstration_or_m: see :data:`Context`.

    Raises:
        ValueError: several demonstrations, one that does not fit the reward, or m of another size.
        FileNotFoundError: the reward is a file that is not there.

    Warns:
        FarFromTraining: a demonstration far from those of training; and the first time that states
            leave the range of training by more than :data:`pemirl_trl.modules.family.FAR`
            deviations, in a component that r reads.
    """

    def __init__(self, reward: Reward, demonstration_or_m: Context) -> None:
        if isinstance(reward, str | Path):
            reward = load_reward(reward)
        self.reward = PortableReward.of(reward) if isinstance(reward, PEMIRLModel) else reward
        self.m = self._inferred(demonstration_or_m)  # [D]
        features = self.reward.config.reward_features
        self._read = [*range(self.reward.observation_dim)] if features is None else [*features]
        self._warned = False

    def _inferred(self, given: Context) -> Tensor:
        if isinstance(given, DemonstrationDataset):
            inference = infer(self.reward, given)
            if inference.distance is not None and inference.distance.far:
                warnings.warn(
                    f"the demonstration is {inference.distance}: its reward may mean nothing",
                    FarFromTraining,
                    stacklevel=4,
                )
            return inference.context
        m = torch.as_tensor(given, dtype=self.reward.standardize.loc.dtype)
        size = self.reward.config.context_dim
        if m.shape != (size,):
            raise ValueError(
                f"got m of shape {list(m.shape)}; expected a demonstration or [{size}]"
            )
        return m

    @torch.no_grad()
    def __call__(self, observation: ArrayLike | Tensor) -> Tensor:
        """Return r(s, m) ``[...]`` of states ``[..., S]``.

        Raises:
            ValueError: the states are not those of the reward.
        """
        value = self.reward(observation, self.m).squeeze(-1)
        if not self._warned:
            self._warn_if_far(torch.as_tensor(observation))
        return value

    def _warn_if_far(self, observation: Tensor) -> None:
        if self.reward.family is None:
            return
        excess = self.reward.family.excess(observation)[..., self._read]
        worst = excess.reshape(-1, len(self._read)).amax(0)
        if float(worst.max()) <= FAR:
            return
        self._warned = True
        component = self._read[int(worst.argmax())]
        warnings.warn(
            f"r is asked {float(worst.max()):.1f} training deviations outside of what was "
            f"demonstrated (component {component} of the observation; far is more than {FAR:g}): "
            "it was not trained there. Said once",
            FarFromTraining,
            stacklevel=4,
        )
