"""A header's fields are those that were asked for, each of its type."""

import pytest

from pemirl_trl.files import check_fields, parse_json

FIELDS = {"count": int, "rate": (int, float), "note": (str, type(None))}


def test_what_fits_comes_back():
    content = {"count": 1, "rate": 0.5, "note": None}
    assert check_fields(content, FIELDS, "it") is content
    assert check_fields({"count": 1}, FIELDS, "it", optional=("rate", "note")) == {"count": 1}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"count": True, "rate": 1, "note": ""}, "it: 'count' is True; expected int"),
        ({"count": 1, "rate": "1", "note": ""}, "it: 'rate' is '1'; expected int or float"),
        ({"count": 1, "rate": 1}, r"it lacks the fields \['note'\]"),
        ({"count": 1, "rate": 1, "note": "", "x": 0}, r"unknown ones \['x'\]"),
        (None, "it is a NoneType; expected the fields"),
    ],
)
def test_what_does_not_is_named(content, message):
    with pytest.raises(ValueError, match=message):
        check_fields(content, FIELDS, "it")


@pytest.mark.parametrize("text", ["", "{", "nul", "[" * 100_000])
def test_what_is_no_json_is_named(text):
    with pytest.raises(ValueError, match="it is damaged: not JSON"):
        parse_json(text, "it")
