"""An inference model for trajectories of any length that looks where it wants to."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from tensordict.utils import NestedKey
from torch import Tensor, nn

from pemirl_trl.modules.context_encoder import GaussianContext, GaussianHead, valid_inputs
from pemirl_trl.modules.network import RowwiseMLP
from pemirl_trl.modules.standardize import Standardize

_PLACES = 3  # numbers that say where in its trajectory a step is


def places(mask: Tensor) -> Tensor:
    """Where each valid step ``[N, T]`` is in its trajectory of L valid steps: ``[N, T, 3]``.

    Of the i-th from 0: (i + 1/2) / L, its share of the way, and 1 / (i + 1) and 1 / (L - i), how
    near the start and the end it is, whatever the length. Of padding they mean nothing.
    """
    index = mask.cumsum(-1).to(torch.get_default_dtype()) - 1.0
    length = mask.sum(-1, keepdim=True)
    before, after = (index + 1).clamp(min=1), (length - index).clamp(min=1)
    return torch.stack([(index + 0.5) / length, 1 / before, 1 / after], -1)


class _AttentionNet(nn.Module):
    def __init__(
        self,
        step_net: nn.Module,
        scores: nn.Module,
        net: nn.Module,
        head: GaussianHead,
        standardize: Standardize,
    ) -> None:
        super().__init__()
        self.standardize, self.step_net, self.scores = standardize, step_net, scores
        self.net, self.head = net, head

    def forward(
        self, observation: Tensor, mask: Tensor | None, *action: Tensor
    ) -> tuple[Tensor, Tensor]:
        inputs, mask = valid_inputs(mask, self.standardize(observation), *action)
        valid = mask.unsqueeze(-1)
        steps = self.step_net(inputs, places(mask).to(inputs.dtype))  # [N, T, W]
        attention = self.scores(steps).masked_fill(~valid, -torch.inf).softmax(-2)  # [N, T, H]
        pooled = attention.mT @ steps  # [N, H, W]
        return self.head(self.net(pooled.flatten(-2)))


class AttentionContextEncoder(GaussianContext):
    """The inference model q_psi(m | tau) for trajectories of any length, by attention.

    Each step is embedded by an MLP, with where in its trajectory it is (:func:`places`). H learned
    queries each average the embeddings by their own softmax over the valid steps, and a second MLP
    gives the Gaussian from the H averages: what a goal was is seen where the trajectory came to
    rest, which an average over all steps blurs. One query is the multi-head attention of Vaswani et
    al. (2017), "Attention Is All You Need", arXiv:1706.03762, with a learned query instead of one
    from the input; the cost is linear in T. Padding is never read: it may hold anything, NaN
    included.

    Reads ``observation`` ``[N, T, S]``, ``action`` ``[N, T, A]`` and, where present, ``mask``
    ``[N, T]`` (boolean, True for valid steps); otherwise as :class:`ContextEncoder`.

    Args:
        observation_dim, action_dim, context_dim: S, A and D.
        hidden: widths of the network of a step; the last one is that of the embedding too.
        heads: H.
        activation, standardize, initial_scale: as in :class:`ContextEncoder`.
        scale_depends_on_input, context_key, reads_actions: as there.
        mask_key: where the mask stands.

    Raises:
        ValueError: on a call, a trajectory without a valid step.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> encoder = AttentionContextEncoder(observation_dim=6, action_dim=2, context_dim=3)
        >>> trajectories = TensorDict(
        ...     {
        ...         "observation": torch.randn(4, 10, 6),
        ...         "action": torch.randn(4, 10, 2),
        ...         "mask": torch.arange(10) < torch.tensor([[10], [7], [3], [1]]),
        ...     },
        ...     [4],
        ... )
        >>> encoder.get_dist(trajectories).mean.shape
        torch.Size([4, 3])
    """

    def __init__(
        self,
        observation_dim: int,
        action_dim: int,
        context_dim: int,
        *,
        hidden: Sequence[int] = (128, 128),
        heads: int = 8,
        activation: type[nn.Module] = nn.ReLU,
        standardize: Standardize | None = None,
        scale_depends_on_input: bool = False,
        initial_scale: float = 1.0,
        context_key: NestedKey = "context",
        mask_key: NestedKey = "mask",
        reads_actions: bool = True,
    ) -> None:
        head = GaussianHead(context_dim, scale_depends_on_input, initial_scale)
        width = hidden[-1]
        step = observation_dim + action_dim * reads_actions + _PLACES
        step_net = RowwiseMLP(step, width, hidden, activation)
        net = RowwiseMLP(heads * width, head.in_features, [width], activation)
        attention = _AttentionNet(
            step_net,
            nn.Linear(width, heads),
            net,
            head,
            standardize or Standardize.identity(observation_dim),
        )
        super().__init__(
            attention, context_dim, context_key, mask_key=mask_key, reads_actions=reads_actions
        )
