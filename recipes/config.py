"""From YAML to the library's typed configurations."""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Mapping
from typing import Any, TypeVar

from omegaconf import DictConfig, OmegaConf

Config = TypeVar("Config")


def plain(node: DictConfig) -> dict[str, Any]:
    """A node of YAML as a dictionary, with its interpolations resolved."""
    return {str(k): v for k, v in OmegaConf.to_container(node, resolve=True).items()}  # type: ignore[union-attr]


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
