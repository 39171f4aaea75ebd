"""What a file's header may hold: every complaint names the file and the field."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any

__all__ = ["check_fields", "parse_json"]

Kinds = type | tuple[type, ...]


def parse_json(text: str, what: str) -> Any:
    """The content of JSON text.

    Args:
        text: JSON.
        what: the file and the place in it, for the message.

    Raises:
        ValueError: not JSON, or nested too deeply to be read.
    """
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{what} is damaged: not JSON ({error})") from error


def check_fields(
    content: Any, expected: Mapping[str, Kinds], what: str, *, optional: Iterable[str] = ()
) -> dict[str, Any]:
    """Return ``content`` if it is a mapping of exactly the ``expected`` fields.

    Args:
        content: what was read from JSON.
        expected: the type of each field, or several; a bool is no int.
        what: the file and the place in it, for the message.
        optional: the fields that may be absent.

    Raises:
        ValueError: it is no mapping, fields are missing or unknown, or one is of another type.
    """
    if not isinstance(content, dict):
        raise ValueError(
            f"{what} is a {type(content).__name__}; expected the fields {sorted(expected)}"
        )
    missing = sorted(expected.keys() - content.keys() - set(optional))
    unknown = sorted(content.keys() - expected.keys())
    if missing or unknown:
        raise ValueError(
            f"{what} lacks the fields {missing} and has unknown ones {unknown}; "
            f"expected {sorted(expected)}"
        )
    for name, value in content.items():
        given = expected[name]
        kinds = given if isinstance(given, tuple) else (given,)
        if type(value) not in kinds:  # JSON has no subclasses, but Python's bool is an int
            wanted = " or ".join(kind.__name__ for kind in kinds)
            raise ValueError(f"{what}: {name!r} is {value!r:.80}; expected {wanted}")
    return content
