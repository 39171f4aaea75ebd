"""A task of one's own: a .py with its .xml, a line that makes it known, and a YAML."""

import gymnasium
import pytest
import torch

import pemirl_envs
from pemirl_envs import tasks
from pemirl_lab.results import read
from pemirl_trl.files import read_metadata

from ..envs.toy_task import Cart
from .conftest import ROOT

CONF = ROOT / "tests/lab/conf"


class Light(Cart):
    """With two finite splits beside that of the toy, and a motor that gets somewhere in time."""

    splits = ("train", "test", "uniform")
    default_split = "train"

    def build_spec(self):
        spec = super().build_spec()
        spec.actuators[0].gear[0] = 10.0
        return spec

    def task_set(self, split):
        count = {"train": 6, "test": 2}[split]
        return {"aim": torch.linspace(-1, 1, count)[:, None]}


class Heavy(Light):
    def build_spec(self):
        spec = super().build_spec()
        spec.geoms[0].mass = 2.0
        return spec


@pytest.fixture
def cart():
    """The line; undone after the test."""
    registries = (tasks.DOMAINS, tasks.TASKS, gymnasium.registry)
    before = [dict(registry) for registry in registries]
    pemirl_envs.register_domain("cart", {"light": Light, "heavy": Heavy})
    yield
    for registry, content in zip(registries, before, strict=True):
        registry.clear()
        registry.update(content)


def test_every_command_knows_it(cart, command, here):
    given = ["--config-dir", str(CONF), "task=cart", "preset=smoke", "logger=null", "threads=1"]
    model = "runs/smoke/meta_train/cart/pemirl_contrastive/seed0"
    for variant in ("light", "heavy"):
        command("train_expert", [*given, f"environment=cart/{variant}"])
        facts = read_metadata(f"{variant}.safetensors")
        assert (facts["environment"], facts["task_key"]) == (f"cart/{variant}", "aim")
    command("collect_demos", given)
    command("collect_demos", [*given, "split=test", "per_task=1", "output=test.safetensors"])
    learned = [*given, "method=pemirl_contrastive"]
    command("meta_train", learned)
    command("adapt_reward", learned)
    command("evaluate", learned)
    assert (here / model / "model.safetensors").exists()
    result = read(
        here / "runs/smoke/evaluate/cart/pemirl_contrastive/seed0/results/pemirl_contrastive.json"
    )
    assert result.task == "cart"
    assert {(s.setting, s.variant) for s in result.scores} == {
        ("one_shot", "light"),
        ("policy_generalisation", "heavy"),
        ("reward_adaptation", "heavy"),
    }
    assert {"context/r2", "behaviour/expert"} <= set(result.reward)
    command("measure_experts", given)
    assert read(here / "results/cart/expert/seed0.json").task == "cart"


def test_a_task_that_nobody_made_known_says_what_would(command, here):
    with pytest.raises(SystemExit) as refused:
        command("meta_train", ["--config-dir", str(CONF), "task=cart"])
    message = str(refused.value)
    assert message.startswith(
        "pemirl meta_train: environment=cart/light: unknown task 'cart/light'"
    )
    assert "pemirl_envs.register_domain" in message
    assert list(here.iterdir()) == []
