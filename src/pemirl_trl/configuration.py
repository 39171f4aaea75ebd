"""How configurations check their values: where they are given, by name, with what is legal.

A configuration is a frozen dataclass of :mod:`pydantic.dataclasses` with ``config=CHECKED``:
another type, a number out of its range, an unknown choice or an unknown name is a ``ValueError``.

>>> from pemirl_trl.methods import TRPOConfig
>>> TRPOConfig(max_kl=-1.0)  # doctest: +ELLIPSIS
Traceback (most recent call last):
    ...
pydantic_core._pydantic_core.ValidationError: 1 validation error for TRPOConfig
max_kl
  Input should be greater than 0 ...
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, TypeVar

import torch
from pydantic import AfterValidator, ConfigDict, Field, TypeAdapter, ValidationError

Config = TypeVar("Config")

CHECKED = ConfigDict(extra="forbid", allow_inf_nan=False)
"""Of every configuration: no unknown names, and numbers that are finite."""

Count = Annotated[int, Field(ge=1, le=10_000_000, strict=True)]
"""A whole number of at least 1; more than ten million of anything is a slip, and would not end."""
Index = Annotated[int, Field(ge=0, le=10_000_000, strict=True)]
"""A whole number of at least 0, likewise."""
SeedNumber = Annotated[int, Field(ge=0, lt=2**63, strict=True)]
"""What torch and NumPy take as a seed."""
Positive = Annotated[float, Field(gt=0, strict=True)]
NonNegative = Annotated[float, Field(ge=0, strict=True)]
Share = Annotated[float, Field(ge=0, le=1, strict=True)]
"""A number from 0 to 1."""
Decay = Annotated[float, Field(gt=0, lt=1, strict=True)]
"""A number between 0 and 1, neither of them included."""


def present_device(name: str) -> str:
    """The name of a device that is here: ``cpu``, ``cuda`` or ``cuda:N``.

    Raises:
        ValueError: it is no such name, or there is no such device; says what there is.
    """
    here = ["cpu", *(f"cuda:{i}" for i in range(torch.cuda.device_count()))]
    if name in here or (name == "cuda" and len(here) > 1):
        return name
    raise ValueError(
        f"{name!r} is no device that torch {torch.__version__} sees here; expected one of "
        f"{', '.join(here)}"
    )


Device = Annotated[str, AfterValidator(present_device)]
"""Where the learner is."""


def typed(cls: type[Config], values: Mapping[str, Any], *, at: str = "") -> Config:
    """Build a (nested) configuration, checking types, ranges, choices and names.

    Args:
        cls: a dataclass.
        values: its fields, nested ones as mappings.
        at: where they stand in what the user wrote, such as ``"training"``.

    Raises:
        ValueError: every wrong value, by its whole name, with what is expected.
    """
    if not isinstance(values, Mapping):
        raise ValueError(f"{at or 'run'}={values}: expected values by name, not one value")
    try:
        return TypeAdapter(cls).validate_python(dict(values))
    except ValidationError as error:
        lines = [_explained(problem, at, cls) for problem in error.errors()]
        raise ValueError("; ".join(lines)) from None


def _explained(problem: Mapping[str, Any], at: str, cls: type) -> str:
    name = ".".join(str(part) for part in (*filter(None, [at]), *problem["loc"]))
    message = problem["msg"].removeprefix("Value error, ")
    if problem["type"] in ("unexpected_keyword_argument", "extra_forbidden"):
        return f"unknown key {name}{_choices(cls, problem['loc'])}"
    if problem["type"] == "missing":
        return f"{name} is missing"
    message = message.replace("Input should be", "expected")
    if problem["loc"]:
        return f"{name}={problem['input']}: {message}"
    return f"{at}: {message}" if at else message


def _choices(cls: Any, loc: Sequence[str | int]) -> str:
    """The names that stand where an unknown one was given, in words; the closest alone if any."""
    for part in loc[:-1]:
        field = getattr(cls, "__pydantic_fields__", {}).get(part)
        cls = None if field is None else field.annotation
    names = [*getattr(cls, "__pydantic_fields__", {})]
    if not names:  # one of several kinds of configuration
        return ""
    close = difflib.get_close_matches(str(loc[-1]), names, n=3)
    return f" (did you mean {' or '.join(close)}?)" if close else f"; expected one of {names}"
