"""The API reference has every public name, once, with something said about it."""

import importlib.util
import re
from pathlib import Path

import pytest

EXTENSION = Path(__file__).parents[1] / "docs/_ext/reference.py"
ENTRY = re.compile(
    r"^\.\. (?:autoclass|autofunction):: ([\w.]+)$"
    r"|^\.\. py:data:: (\w+)\n   :module: ([\w.]+)$",
    re.MULTILINE,
)


@pytest.fixture(scope="module")
def reference():
    spec = importlib.util.spec_from_file_location("reference", EXTENSION)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def entries(pages):
    found = [entry for text in pages.values() for entry in ENTRY.findall(text)]
    return [whole or f"{module}.{name}" for whole, name, module in found]


def test_every_public_name_has_one_entry(reference):
    exported = reference.public_names()
    homes = reference.homes(exported)
    assert homes.keys() == {f"{m}.{name}" for m, names in exported.items() for name in names}
    documented = entries(reference.pages())
    assert len(documented) == len(set(documented))
    assert set(documented) == set(homes.values())
    assert {"pemirl_trl.adapt", "pemirl_envs.TASKS", "pemirl_lab.results.Result"} <= set(documented)


def test_a_name_is_documented_where_its_path_is_shortest(reference):
    homes = reference.homes(reference.public_names())
    assert homes["pemirl_trl.objectives.InfoLoss"] == "pemirl_trl.InfoLoss"
    assert homes["pemirl_trl.data.doctor.examine"] == "pemirl_trl.data.examine"


def test_bars_are_no_substitutions(reference):
    assert reference.escaped("|r| and ``|r|``") == r"\|r\| and ``|r|``"
