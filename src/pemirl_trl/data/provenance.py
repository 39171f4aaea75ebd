"""Where demonstrations come from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from pemirl_trl.files import check_fields

__all__ = ["Provenance", "parse_provenance"]

_FIELDS: dict[str, type | tuple[type, ...]] = {
    "environment": str,
    "seed": (int, type(None)),
    "expert_return": (int, float, type(None)),
    "code_version": str,
    "command": str,
    "extra": dict,
}


@dataclass(frozen=True)
class Provenance:
    """Where demonstrations come from.

    Args:
        environment: Name of the task that was demonstrated.
        seed: Seed of the collection.
        expert_return: Mean return of the expert on the true reward.
        code_version: Version or commit of the code that collected them.
        command: The command that did.
        extra: Anything else, as strings.
    """

    environment: str = "unknown"
    seed: int | None = None
    expert_return: float | None = None
    code_version: str = "unknown"
    command: str = "unknown"
    extra: Mapping[str, str] = field(default_factory=dict)


def parse_provenance(content: Any, what: str) -> Provenance:
    """The provenance that a file states; fields that it does not state are unknown.

    Args:
        content: what was read from JSON.
        what: the file and the place in it, for the message.

    Raises:
        ValueError: fields of other names or types.
    """
    stored = check_fields(content, _FIELDS, what, optional=_FIELDS)
    extra = stored.get("extra", {})
    check_fields(extra, dict.fromkeys(extra, str), f"{what}: extra")
    return Provenance(**stored)
