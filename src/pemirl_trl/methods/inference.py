"""What one demonstration asks for, by a trained model."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import torch
from numpy.typing import ArrayLike
from tensordict import TensorDict
from torch import Tensor
from torch.distributions import Distribution
from torchrl.envs.utils import ExplorationType, set_exploration_type

from pemirl_trl.data import DemonstrationDataset
from pemirl_trl.methods.early_ends import for_model
from pemirl_trl.methods.own_training import as_dataset, check_model
from pemirl_trl.modules import FamilyDistance, PEMIRLModel, ShapedReward
from pemirl_trl.modules.model import Policy
from pemirl_trl.sharing import PortableReward


@dataclass(frozen=True, eq=False)
class Inference:
    """A demonstration's context and reward.

    Attributes:
        posterior: q(m | demonstration), over ``[D]``.
        context: ``[D]``, its mean.
        distance: how far the demonstration is from those of training; None where the model's file
            does not say what these were.
    """

    posterior: Distribution
    context: Tensor
    distance: FamilyDistance | None
    _model: PEMIRLModel | PortableReward = field(repr=False)

    @torch.no_grad()
    def reward(self, observation: Tensor | ArrayLike) -> Tensor:
        """Return r(s, m) ``[..., 1]`` of states ``[..., S]``, without a unit.

        Where episodes end by themselves, states are as in the environment, or with the indicator of
        absorbing states as one component more, 1 for having ended there.

        Raises:
            ValueError: the states are not those of the model.
        """
        return self._model.reward.reward(self._states(observation), self.context)

    @torch.no_grad()
    def action(
        self,
        observation: Tensor | ArrayLike,
        policy: Policy | None = None,
        *,
        sample: bool = False,
    ) -> Tensor:
        """Return what a policy does in states ``[..., S]``, asked for this task: ``[..., A]``.

        Args:
            observation: states, as in the environment; a tensor or any array of numbers.
            policy: an adapted one, of :func:`pemirl_trl.load_policy` or ``adapt(...).policy``; by
                default the one that the model was meta-trained with, which imitates.
            sample: draw an action; by default it is the mean. A discrete one is one-hot: the
                likeliest choice by default, and ``action.argmax(-1)`` is its number.

        Raises:
            ValueError: the states are not those of the model; or no policy is given, and a reward
                alone, which brings none, was asked.
        """
        if policy is None:
            if not isinstance(self._model, PEMIRLModel):
                raise ValueError("a reward brings no policy: give one of load_policy(FILE, model)")
            policy = self._model.policy
        states = self._states(observation)
        context = self.context.expand(*states.shape[:-1], -1)
        given = TensorDict({"observation": states, "context": context}, states.shape[:-1])
        drawn = ExplorationType.RANDOM if sample else ExplorationType.DETERMINISTIC
        with set_exploration_type(drawn):
            return policy(given)["action"]

    def _states(self, observation: Tensor | ArrayLike) -> Tensor:
        """States as the networks read them."""
        size = self._model.observation_dim
        observation = torch.as_tensor(observation, dtype=torch.get_default_dtype())
        if self._model.config.absorbing and observation.shape[-1:] == (size - 1,):
            observation = torch.nn.functional.pad(observation, (0, 1))
        if observation.shape[-1:] != (size,):
            raise ValueError(f"got states {list(observation.shape)}; expected [..., {size}]")
        return observation

    def __str__(self) -> str:
        """Return m with its deviation, and the distance, in a few lines."""
        pairs = zip(self.context.tolist(), self.posterior.stddev.tolist(), strict=True)
        m = ", ".join(f"{mean:.3f} ± {deviation:.3f}" for mean, deviation in pairs)
        distance = "unknown: the model does not say what it was trained on"
        return f"m = [{m}]\ndistance: {self.distance or distance}"


def infer(
    model: PEMIRLModel | PortableReward, demonstration: DemonstrationDataset | str | Path
) -> Inference:
    """Infer the context and the reward of one demonstration.

    Args:
        model: a trained one, or its reward alone, of :func:`pemirl_trl.load_reward`.
        demonstration: a data set of one, or the file of it; without actions, if the encoder reads
            states alone (``encoder_reads="states"``).

    Raises:
        TypeError: something else than a model, such as the name of its file.
        ValueError: several demonstrations, or one of another size or length than the model's; or a
            model without contexts or without r(s, m).
    """
    check_model(model, PEMIRLModel, PortableReward)
    data = as_dataset(demonstration)
    if len(data) != 1:
        raise ValueError(
            f"got {len(data)} demonstrations; expected one, such as demonstrations[0]: each has a "
            "context of its own"
        )
    data = check_demonstrations(model, data)
    with torch.no_grad():
        posterior = model.encoder.get_dist(data.trajectories())
        one = type(posterior)(type(posterior.base_dist)(posterior.mean[0], posterior.stddev[0]), 1)
    context = one.mean
    distance = None
    if model.family is not None:
        distance = model.family.distance(context, data.observation[0])
    return Inference(one, context, distance, model)


def check_demonstrations(
    model: PEMIRLModel | PortableReward, demonstrations: DemonstrationDataset
) -> DemonstrationDataset:
    """Return demonstrations as a model reads them; raise ValueError unless it can."""
    if model.config.context_dim == 0 or not isinstance(model.reward, ShapedReward):
        raise ValueError(
            "this model infers no reward r(s, m): expected one with contexts and reward='shaped', "
            f"got context_dim={model.config.context_dim}, reward={model.config.reward!r}"
        )
    d = for_model(model, demonstrations)
    model.encoder.check_recorded(d.action)
    acted = d.action_dim > 0
    got, wanted = (
        (d.observation_dim, d.action_dim, d.horizon),
        (model.observation_dim, model.action_dim if acted else 0, model.horizon),
    )
    if got != wanted:
        raise ValueError(
            f"the demonstrations have (S, A, T) = {got}: observed numbers, actions and steps; this "
            f"model was trained on {wanted}"
            + (", absorbing states and their indicator included" if d.absorbing else "")
        )
    if acted and model.config.actions == "discrete" and not d.discrete:
        raise ValueError(
            f"the demonstrated actions are vectors of real numbers; this model was trained on "
            f"{model.action_dim} choices, one-hot: from_episodes(..., discrete_actions="
            f"{model.action_dim}) makes such of integers"
        )
    return d
