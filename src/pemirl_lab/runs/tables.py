"""Tables of experiments: named rows, each a list of overrides as on the command line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf
from pydantic.dataclasses import dataclass

from pemirl_lab.runs.composition import compose, override_key, plain
from pemirl_lab.runs.places import PACKAGE
from pemirl_trl.configuration import CHECKED, Count, typed

TABLES = PACKAGE / "tables"


@dataclass(frozen=True, config=CHECKED)
class Row:
    """One configuration of a table.

    Attributes:
        label: what it is called on the pages.
        overrides: what sets it apart.
        seeds: how many, where it is not the table's number.
    """

    label: str
    overrides: Sequence[str] = ()
    seeds: Count | None = None


@dataclass(frozen=True, config=CHECKED)
class Table:
    """A comparison.

    Attributes:
        rows: by name.
        overrides: of every row.
        seeds: how many each row has, unless it says otherwise.
        name: of the table.
    """

    rows: Mapping[str, Row]
    overrides: Sequence[str] = ()
    seeds: Count = 5
    name: str = field(default="")

    def row(self, name: str) -> Row:
        """A row by its name; ValueError lists those that there are."""
        if name not in self.rows:
            raise ValueError(
                f"table {self.name} has no row {name!r}; choose one of {', '.join(self.rows)}"
            )
        return self.rows[name]

    def seeds_of(self, name: str) -> int:
        """How many seeds a row has."""
        return self.row(name).seeds or self.seeds

    def compose(self, name: str, overrides: Sequence[str] = ()) -> dict[str, Any]:
        """A row's resolved configuration; ``overrides`` of the command line win over the row's."""
        resolved = plain(compose("reproduce", self.chosen(name, overrides)))
        return {"seeds": self.seeds_of(name), **resolved}

    def chosen(self, name: str, overrides: Sequence[str] = ()) -> list[str]:
        """What a row overrides, together with the command line; of two for one key the later."""
        every = [*self.overrides, *self.row(name).overrides, *overrides]
        every += [f"table={self.name}", f"row={name}"]
        return list({override_key(text): text for text in every}.values())


def read_table(name: str) -> Table:
    """The table of a name, or of a YAML file.

    Raises:
        ValueError: there is no such table, or its file is wrong; lists the names, or says where.
    """
    file = Path(name).expanduser() if name.endswith(".yaml") else TABLES / f"{name}.yaml"
    if not file.is_file():
        raise ValueError(f"no table {name!r}; choose one of {', '.join(table_names())}, or a file")
    values = OmegaConf.to_container(OmegaConf.load(file), resolve=False)
    if not isinstance(values, dict):
        raise ValueError(f"{file} is no table: expected rows")
    return typed(Table, {**values, "name": file.stem}, at=str(file))  # type: ignore[dict-item]


def table_names() -> list[str]:
    """Of the tables that come with this package."""
    return sorted(file.stem for file in TABLES.glob("*.yaml"))
