"""What the policies over continuous actions and over choices have in common."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from tensordict.utils import NestedKey
from torch import Tensor, nn
from torch.distributions import Distribution
from torchrl.modules import ProbabilisticActor

from pemirl_trl.modules.direct import DirectModule
from pemirl_trl.modules.standardize import Standardize


class ContextActor(ProbabilisticActor):
    """A distribution of actions whose parameters a network gives from observation and context.

    Args:
        network: observations and contexts in, one tensor of each of ``parameters`` out; it has a
            ``net``, a ``standardize`` and a ``log_scale``.
        parameters: names of the distribution's.
        distribution: builds it from them.
        action_dim: A.
        context_key, log_prob_key: as in :class:`pemirl_trl.ContextPolicy`.
    """

    def __init__(
        self,
        network: nn.Module,
        parameters: Sequence[str],
        distribution: Callable[..., Distribution],
        *,
        action_dim: int,
        context_key: NestedKey,
        log_prob_key: NestedKey,
    ) -> None:
        reads: list[NestedKey] = ["observation", context_key]
        super().__init__(
            module=DirectModule(network, reads, [*parameters], reader=type(self).__name__),
            in_keys=[*parameters],
            out_keys=["action"],
            distribution_class=distribution,
            return_log_prob=True,
            log_prob_key=log_prob_key,
        )
        self.observation_key, self.context_key = reads
        self.action_key: NestedKey = "action"
        self.action_dim = action_dim

    @property
    def log_prob_key(self) -> NestedKey:
        """Where log pi is written."""
        return self[-1].log_prob_key

    @property
    def network(self) -> Any:
        """The network of the distribution's parameters."""
        return self.module[0].net

    @property
    def net(self) -> nn.Module:
        """The network of the mean, or of the logits."""
        return self.network.net

    @property
    def standardize(self) -> Standardize:
        """The map of observations."""
        return self.network.standardize

    @property
    def log_scale(self) -> Tensor:
        """Logarithm of the deviation ``[A]``, or of the share of uniform actions ``[1]``."""
        return self.network.log_scale
