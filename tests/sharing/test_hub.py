"""Folders as model hubs have them: written and read here, and by huggingface_hub's own mixin."""

import json

import pytest
import torch
from huggingface_hub import PyTorchModelHubMixin
from safetensors.torch import load_file, save_file

from pemirl_trl import Card, ModelConfig, PEMIRLModel, PortableReward, TrainingFamily

CARD = Card(domain="toy", licence="MIT", measures={"return": 1.0})
STATES, M = torch.linspace(-1, 1, 12).reshape(4, 3), torch.tensor([0.5, -0.5])


class HubReward(PyTorchModelHubMixin, PortableReward):
    """What docs/reward_files.md says: the mixin in front."""


@pytest.fixture(autouse=True)
def offline(monkeypatch):
    """Nothing here may wait for a network: a request would be an error."""
    monkeypatch.setenv("HF_HUB_OFFLINE", "1")


def reward(cls=PortableReward):
    torch.manual_seed(0)
    config = ModelConfig(context_dim=2, encoder_hidden=(5,), reward_hidden=(3,))
    model = PEMIRLModel(3, 2, 4, config)
    scale = model.standardize.scale
    model.family = TrainingFamily.fit(torch.randn(6, 2), torch.randn(6, 5, 3), scale)
    return cls.of(model, CARD)


def same(a, b):
    assert torch.equal(a(STATES, M), b(STATES, M))
    assert a.card == b.card == CARD
    assert a.family.context_distance == b.family.context_distance
    for name, value in a.state_dict().items():
        assert torch.equal(value, b.state_dict()[name]), name


@pytest.mark.parametrize("writer", [PortableReward, HubReward])
@pytest.mark.parametrize("reader", [PortableReward, HubReward])
def test_each_reads_what_the_other_writes(tmp_path, writer, reader):
    written = reward(writer)
    written.save_pretrained(tmp_path)
    assert {f.name for f in tmp_path.iterdir()} == {
        "config.json",
        "model.safetensors",
        "README.md",
    }
    same(reader.from_pretrained(tmp_path), written)


def test_the_page_says_what_the_card_does(tmp_path):
    reward().save_pretrained(tmp_path)
    assert (tmp_path / "README.md").read_text() == CARD.markdown("toy")


def config_with(folder, **changed):
    file = folder / "config.json"
    file.write_text(json.dumps(json.loads(file.read_text()) | changed))


def damage_weights(folder):
    weights = load_file(folder / "model.safetensors")
    name = next(iter(weights))
    save_file({**weights, name: weights[name] + 1}, folder / "model.safetensors")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (damage_weights, "its SHA-256 is not the one in"),
        (lambda f: config_with(f, sizes=None), "'sizes' is None; expected dict"),
        (lambda f: config_with(f, sizes={"horizon": 1}), "lacks the fields"),
        (lambda f: config_with(f, card=[]), "'card' is"),
        (lambda f: (f / "config.json").write_text("["), "not JSON"),
        (lambda f: (f / "config.json").write_text("[]"), "is a list"),
        (lambda f: (f / "model.safetensors").write_bytes(b"x"), "its SHA-256 is not"),
    ],
)
def test_a_damaged_folder_is_refused_by_name(tmp_path, change, message):
    reward().save_pretrained(tmp_path)
    change(tmp_path)
    with pytest.raises(ValueError, match=message) as raised:
        PortableReward.from_pretrained(tmp_path)
    assert str(tmp_path) in str(raised.value)


def test_sizes_that_are_not_the_tensors_are_refused_before_anything_is_built(tmp_path):
    reward().save_pretrained(tmp_path)
    config = json.loads((tmp_path / "config.json").read_text())
    sizes = {**config["sizes"], "horizon": 10**9}
    config_with(tmp_path, sizes=sizes)
    with pytest.raises(ValueError, match="not those of a model of its sizes"):
        PortableReward.from_pretrained(tmp_path)


@pytest.mark.parametrize("name", ["config.json", "model.safetensors"])
def test_a_missing_file_is_named(tmp_path, name):
    reward().save_pretrained(tmp_path)
    (tmp_path / name).unlink()
    with pytest.raises(FileNotFoundError, match=name):
        PortableReward.from_pretrained(tmp_path)
