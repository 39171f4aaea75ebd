"""What a check of demonstrations says, and the words that checks share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from torch import Tensor

from pemirl_trl.data.validation import episode_names

__all__ = ["CONSTANT", "Finding", "numbers"]

Severity = Literal["warning", "error"]

CONSTANT = 1e-6
"""A feature of no more deviation counts as constant, as in pemirl_trl.modules.Standardize."""


@dataclass(frozen=True)
class Finding:
    """One thing that is suspicious.

    Attributes:
        severity: ``"error"`` if learning from this makes no sense, ``"warning"`` if it may.
        what: what was found.
        where: the episodes or features.
        cure: what to do.
    """

    severity: Severity
    what: str
    where: str
    cure: str

    def __str__(self) -> str:
        return f"{self.severity}: {self.what} ({self.where}); {self.cure}"


def numbers(chosen: Tensor) -> str:
    """``feature 3`` or ``features 0, 3`` where ``chosen`` ``[F]`` is true."""
    return episode_names(chosen.nonzero().flatten()).replace("episode", "feature")
