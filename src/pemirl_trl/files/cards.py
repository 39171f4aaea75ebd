"""What a file of weights says about itself: where it is from, how it was made, what it reached."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from typing import Any

from pemirl_trl.files.headers import check_fields

__all__ = ["Card", "parse_card"]

_SCALARS = (str, int, float, bool, type(None))


@dataclass(frozen=True)
class Card:
    """What there is to know before a model or a reward is used elsewhere.

    Attributes:
        domain: the environment that was demonstrated.
        data_sha256: of the demonstrations' observations and actions, whatever their file:
            :func:`pemirl_trl.methods.own_training.digest`.
        settings: how it was trained: method, seed and what else; JSON.
        measures: what it reached, by name.
        licence: of the weights, an SPDX identifier.
        command: what makes it anew.
        versions: of the packages that it was made with.
    """

    domain: str = "unknown"
    data_sha256: str = "unknown"
    settings: Mapping[str, Any] = field(default_factory=dict)
    measures: Mapping[str, float] = field(default_factory=dict)
    licence: str = "unknown"
    command: str = "unknown"
    versions: Mapping[str, str] = field(default_factory=dict)

    def json(self) -> dict[str, Any]:
        """Return the fields, as a header holds them."""
        return asdict(self)

    def markdown(self, name: str) -> str:
        """Return a page titled ``name``; its head is YAML that model hubs read."""
        facts = {
            "demonstrated in": self.domain,
            "demonstrations, SHA-256": f"`{self.data_sha256}`",
            "licence": self.licence,
            "made by": f"`{self.command}`",
            "with": ", ".join(f"{k} {v}" for k, v in self.versions.items()) or "unknown",
        }
        lines = [
            *("---", f"license: {self.licence.lower()}", "library_name: pemirl-trl"),
            *("tags:", "- inverse-reinforcement-learning", "- reward-model", "---", ""),
            *(f"# {name}", "", "| | |", "| --- | --- |"),
            *(f"| {key} | {value} |" for key, value in facts.items()),
        ]
        for title, rows in (("Measures", self.measures), ("Settings", _flat(self.settings))):
            lines += ["", f"## {title}", ""]
            if not rows:
                lines += ["none"]
                continue
            lines += ["| | |", "| --- | --- |"]
            lines += [f"| {key} | {_shown(value)} |" for key, value in rows.items()]
        return "\n".join(lines) + "\n"


def parse_card(content: Any, what: str) -> Card:
    """The card that a header states; fields that it does not state are unknown.

    Args:
        content: what was read from JSON.
        what: the file and the place in it, for the message.

    Raises:
        ValueError: fields of other names or types.
    """
    kinds: dict[str, type] = {
        f.name: dict if f.name in ("settings", "measures", "versions") else str
        for f in fields(Card)
    }
    stated = check_fields(content, kinds, what, optional=kinds)
    for name, kind in (("measures", (int, float)), ("versions", str)):
        values = stated.get(name, {})
        check_fields(values, dict.fromkeys(values, kind), f"{what}: {name}")
    return Card(**stated)


def _flat(settings: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Nested mappings as ``a.b`` to a scalar or a list."""
    flat: dict[str, Any] = {}
    for key, value in settings.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{prefix}{key}.")
        else:
            flat[f"{prefix}{key}"] = value
    return flat


def _shown(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.4g}"
    return str(value) if isinstance(value, _SCALARS) else ", ".join(map(str, value))
