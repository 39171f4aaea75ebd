"""A learned reward with all that it takes to ask it, and nothing else of its model."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Self

import torch
from numpy.typing import ArrayLike
from torch import Tensor, nn

from pemirl_trl.files import Card, expanded, parse_card
from pemirl_trl.functional import shaped_reward
from pemirl_trl.modules import ModelConfig, PEMIRLModel, ShapedReward
from pemirl_trl.pretrained import build_model, parse_family, sizes_of, state_family
from pemirl_trl.sharing.hub import read_folder, write_folder


class PortableReward(nn.Module):
    """r(s, m) with its potential, and q(m | demonstration), which says what m is.

    It takes raw observations: the map of observations is inside. Numbers of any type are taken,
    NumPy's included. r alone is what transfers to other dynamics; f = r + gamma h(s') - h(s) is r
    with the shaping that it was learned with.

    ``save_pretrained`` and ``from_pretrained`` write and read a folder as
    ``huggingface_hub.PyTorchModelHubMixin`` does; a class derived from that mixin and this one can
    also push it and pull it.

    Attributes:
        encoder: q(m | demonstration).
        reward: r and h, a :class:`pemirl_trl.ShapedReward`.
        standardize: the map of observations that all three share.
        family: statistics of the training demonstrations; None where nobody knows them.
        card: where it is from; None where it does not say.
        config: sizes of the networks.
        observation_dim, action_dim, horizon: S, A and T of the demonstrations.

    Args:
        sizes: :func:`pemirl_trl.pretrained.sizes_of` a model.
        family, card: as JSON has them.

    Raises:
        ValueError: a model without r(s, m), GAIL's; or a family or a card of other fields.

    Example:
        >>> from pemirl_trl import PEMIRLModel
        >>> reward = PortableReward.of(PEMIRLModel(6, 2, 10))
        >>> reward([[0.0] * 6] * 5, [0.1, 0.2, 0.3]).shape
        torch.Size([5, 1])
    """

    def __init__(
        self,
        sizes: dict[str, Any],
        family: dict[str, Any] | None = None,
        card: dict[str, Any] | None = None,
    ) -> None:
        super().__init__()
        config = ModelConfig(**sizes["config"])
        if config.reward != "shaped":
            raise ValueError(
                f"this model has no reward r(s, m) to share: reward={config.reward!r}; expected "
                "'shaped'"
            )
        model = build_model(sizes)
        self.sizes, self.config = dict(sizes), config
        self.observation_dim, self.action_dim = model.observation_dim, model.action_dim
        self.horizon = model.horizon
        self.standardize, self.encoder = model.standardize, model.encoder
        self.reward: ShapedReward = model.reward
        what = "of this reward"
        self.family = None if family is None else parse_family(family, sizes, f"the family {what}")
        self.card = None if card is None else parse_card(card, f"the card {what}")
        self.requires_grad_(False)

    @classmethod
    def of(cls, model: PEMIRLModel, card: Card | None = None) -> Self:
        """Return a copy of a model's reward and encoder, without gradients."""
        family = None if model.family is None else state_family(model.family)
        reward = cls(sizes_of(model), family, None if card is None else card.json())
        state = model.state_dict()
        reward.load_state_dict({name: state[name] for name in reward.state_dict()})
        return reward

    def forward(self, observation: Tensor | ArrayLike, m: Tensor | ArrayLike) -> Tensor:
        """Return r(s, m) ``[..., 1]``, without a unit.

        Args:
            observation: ``[..., S]``, raw; gradients with respect to it are kept.
            m: ``[..., D]``; ``[D]``, or a size of 1, serves all observations.

        Raises:
            ValueError: the shapes do not fit.
        """
        return self.reward.reward(self._states(observation), self._context(m))

    def potential(self, observation: Tensor | ArrayLike, m: Tensor | ArrayLike) -> Tensor:
        """Return h(s, m) ``[..., 1]``; shapes and errors are those of a call."""
        return self.reward.potential(self._states(observation), self._context(m))

    def shaped(
        self,
        observation: Tensor | ArrayLike,
        next_observation: Tensor | ArrayLike,
        m: Tensor | ArrayLike,
    ) -> Tensor:
        """Return f(s, s', m) = r(s, m) + gamma h(s', m) - h(s, m), ``[..., 1]``."""
        here, there = self.potential(observation, m), self.potential(next_observation, m)
        return shaped_reward(self(observation, m), here, there, self.reward.gamma)

    def save_pretrained(self, save_directory: str | Path) -> None:
        """Write ``config.json``, ``model.safetensors`` and, of a card, ``README.md`` to a folder.

        Raises:
            OSError: it cannot be written.
        """
        config = {
            "sizes": self.sizes,
            "family": None if self.family is None else state_family(self.family),
            "card": None if self.card is None else self.card.json(),
        }
        write_folder(expanded(save_directory), self, config, self.card)

    @classmethod
    def from_pretrained(cls, directory: str | Path) -> Self:
        """Read the folder of :meth:`save_pretrained`, without a network and without unpickling.

        Raises:
            FileNotFoundError: there is no such folder, or it lacks a file.
            ValueError: its files hold something else, are damaged, or do not fit together.
        """
        config, tensors = read_folder(expanded(directory), ("sizes", "family", "card"))
        reward = cls(**config)
        reward.load_state_dict(tensors)
        return reward

    def _states(self, observation: Tensor | ArrayLike) -> Tensor:
        states = torch.as_tensor(observation, dtype=self.standardize.loc.dtype)
        if states.shape[-1:] != (self.observation_dim,):
            raise ValueError(
                f"got observations {list(states.shape)}; expected [..., {self.observation_dim}]"
            )
        return states

    def _context(self, m: Tensor | ArrayLike) -> Tensor:
        context = torch.as_tensor(m, dtype=self.standardize.loc.dtype)
        if context.shape[-1:] != (self.config.context_dim,):
            raise ValueError(
                f"got m {list(context.shape)}; expected [..., {self.config.context_dim}], such as "
                "pemirl_trl.infer(reward, demonstration).context"
            )
        return context
