"""From resolved values to typed configurations; a wrong one is named as the user wrote it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

Config = TypeVar("Config")


def typed(cls: type[Config], values: Mapping[str, Any], *, at: str = "") -> Config:
    """Build a (nested) configuration, checking types, ranges, choices and names.

    Args:
        cls: a dataclass.
        values: its fields, as YAML has them.
        at: where they stand in what the user wrote, such as ``"training"``.

    Raises:
        ValueError: every wrong value, by its whole name, with what is expected.
    """
    if not isinstance(values, Mapping):
        raise ValueError(f"{at or 'run'}={values}: expected values by name, not one value")
    try:
        return TypeAdapter(cls).validate_python(dict(values))
    except ValidationError as error:
        lines = [_explained(problem, at) for problem in error.errors()]
        raise ValueError("; ".join(lines)) from None


def _explained(problem: Mapping[str, Any], at: str) -> str:
    name = ".".join(str(part) for part in (*filter(None, [at]), *problem["loc"]))
    message = problem["msg"].removeprefix("Value error, ")
    if problem["type"] in ("unexpected_keyword_argument", "extra_forbidden"):
        return f"unknown key {name}"
    if problem["type"] == "missing":
        return f"{name} is missing"
    message = message.replace("Input should be", "expected")
    if problem["loc"]:
        return f"{name}={problem['input']}: {message}"
    return f"{at}: {message}" if at else message


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
