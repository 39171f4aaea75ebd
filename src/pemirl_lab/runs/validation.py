"""From YAML to the library's typed configurations."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeVar

from omegaconf import DictConfig, OmegaConf

Config = TypeVar("Config")


def plain(node: DictConfig) -> dict[str, Any]:
    """A node of YAML as a dictionary, with its interpolations resolved."""
    return {str(k): v for k, v in OmegaConf.to_container(node, resolve=True).items()}  # type: ignore[union-attr]


def changed_settings(
    stored: Mapping[str, Any], now: Mapping[str, Any], *, ignore: Sequence[str] = ()
) -> list[str]:
    """Settings that both have, with other values: ``"a.b=1, now 2"`` each, in the order of ``now``.

    Names that only one of them has are no change: a release adds and drops settings.
    """
    before = dict(_leaves(stored))
    return [
        f"{name}={before[name]}, now {value}"
        for name, value in _leaves(now)
        if name in before and before[name] != value and name not in ignore
    ]


def _leaves(node: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in node.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def typed(cls: type[Config], node: DictConfig | Mapping[str, Any]) -> Config:
    """Build a (nested) dataclass from a node of YAML.

    Raises:
        ValueError: the node has a key that the dataclass lacks; names it and the legal ones.
    """
    values: dict[str, Any] = plain(node) if isinstance(node, DictConfig) else dict(node)
    hints = typing.get_type_hints(cls)
    legal = [f.name for f in dataclasses.fields(cls)]  # type: ignore[arg-type]
    unknown = sorted(set(values) - set(legal))
    if unknown:
        raise ValueError(f"unknown keys {unknown} for {cls.__name__}; legal are {legal}")
    return cls(
        **{
            name: typed(hints[name], value) if dataclasses.is_dataclass(hints[name]) else value
            for name, value in values.items()
        }
    )
