"""Recipes inside this process: imported as their scripts import each other, composed by Hydra."""

import importlib
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig

RECIPES = Path(__file__).parents[2] / "recipes"
SMOKE = ("preset=smoke", "threads=1", "run_dir=smoke")


@pytest.fixture
def recipe(monkeypatch):
    """Imports a module of recipes/ by its name."""
    monkeypatch.syspath_prepend(str(RECIPES))
    return importlib.import_module


def config(name: str, *overrides: str, hydra: bool = False) -> DictConfig:
    """A recipe's configuration; with ``hydra``, Hydra's own as well."""
    with initialize_config_dir(str(RECIPES / "conf"), version_base="1.3"):
        return compose(name, list(overrides), return_hydra_config=hydra)
