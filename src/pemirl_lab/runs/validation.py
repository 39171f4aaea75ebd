"""What changed between two resolved configurations."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any


def changed_settings(
    stored: Mapping[str, Any], now: Mapping[str, Any], *, ignore: Sequence[str] = ()
) -> list[str]:
    """Settings that both have, with other values: ``"a.b=1, now 2"`` each, in the order of ``now``.

    Names that only one of them has are no change: a release adds and drops settings.
    """
    before = dict(leaves(stored))
    return [
        f"{name}={before[name]}, now {value}"
        for name, value in leaves(now)
        if name in before and before[name] != value and name not in ignore
    ]


def leaves(node: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """All values of a nested mapping, by their dotted names."""
    for key, value in node.items():
        if isinstance(value, Mapping) and value:
            yield from leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value
