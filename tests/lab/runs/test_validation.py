"""Wrong values are named as the user wrote them; changed ones are listed."""

from collections.abc import Mapping, Sequence

import pytest
from pydantic.dataclasses import dataclass

from pemirl_lab.runs.validation import changed_settings, leaves
from pemirl_trl.configuration import CHECKED, Count, typed


@dataclass(frozen=True, config=CHECKED)
class Inner:
    sizes: Sequence[Count] = ()


@dataclass(frozen=True, config=CHECKED)
class Outer:
    name: str
    inner: Mapping[str, Inner]

    def __post_init__(self):
        if self.name == "taken":
            raise ValueError("the name is taken")


@pytest.mark.parametrize(
    ("values", "at", "message"),
    [
        ({"name": 1, "inner": {}}, "", "^name=1: expected a valid string$"),
        ({"name": "a", "inner": {"b": {"sizes": [1, 0]}}}, "", r"^inner\.b\.sizes\.1=0: expected"),
        ({"name": "a", "inner": {"b": {"sise": []}}}, "here", r"^unknown key here\.inner\.b\.sise"),
        (
            {"name": "a", "innner": {}},
            "f.yaml",
            r"^f\.yaml\.inner is missing; unknown key f\.yaml\.innner \(did you mean inner\?\)$",
        ),
        ({"name": "taken", "inner": {}}, "", "^the name is taken$"),
        ({"name": "taken", "inner": {}}, "f.yaml", r"^f\.yaml: the name is taken$"),
    ],
)
def test_a_wrong_value_has_its_whole_name(values, at, message):
    with pytest.raises(ValueError, match=message):
        typed(Outer, values, at=at)


def test_nested_values_are_typed():
    assert typed(Outer, {"name": "a", "inner": {"b": {"sizes": [1, 2]}}}).inner["b"].sizes == [1, 2]


def test_leaves_have_dotted_names_and_empty_mappings_are_values():
    node = {"a": 1, "b": {"c": [2], "d": {"e": None}}, "f": {}}
    assert dict(leaves(node)) == {"a": 1, "b.c": [2], "b.d.e": None, "f": {}}


def test_changes_are_of_what_both_have():
    stored = {"a": 1, "b": {"c": 2, "gone": 3}, "threads": 1}
    now = {"a": 1, "b": {"c": 5, "new": 6}, "threads": 2}
    assert changed_settings(stored, now, ignore=("threads",)) == ["b.c=2, now 5"]
    assert changed_settings(stored, now) == ["b.c=2, now 5", "threads=1, now 2"]
