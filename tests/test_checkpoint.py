"""A resumed run continues bit for bit; a crash costs nothing; nothing is unpickled."""

import json
import pickle
import random

import numpy as np
import pytest
import torch
from torch import nn
from torchrl.checkpoint import Checkpoint, CheckpointError

from pemirl_trl.checkpoint import TrainingCheckpoint
from pemirl_trl.files import load_weights, save_weights


class Counter:
    """State of every kind that a checkpoint takes."""

    def __init__(self) -> None:
        self.state = {}

    def state_dict(self):
        return self.state

    def load_state_dict(self, state_dict):
        self.state = state_dict


def training(seed):
    torch.manual_seed(seed)
    net = nn.Sequential(nn.Linear(3, 4), nn.BatchNorm1d(4), nn.Linear(4, 1))
    return {"net": net, "adam": torch.optim.Adam(net.parameters(), lr=1e-2)}


def advance(parts, steps=3):
    for _ in range(steps):
        noise = torch.randn(8, 3) + np.random.normal() + random.random()  # noqa: NPY002
        loss = parts["net"](noise).square().mean()
        parts["adam"].zero_grad()
        loss.backward()
        parts["adam"].step()


def test_resumed_training_is_bit_identical(tmp_path):
    checkpoint = TrainingCheckpoint(tmp_path)
    straight = training(0)
    advance(straight)
    checkpoint.save(straight, 3)
    advance(straight)

    resumed = training(1)  # other weights, and a random state elsewhere
    assert checkpoint.load_latest(resumed) == 3
    advance(resumed)
    for name, value in straight["net"].state_dict().items():
        assert torch.equal(resumed["net"].state_dict()[name], value), name


def test_state_of_every_kind_comes_back_equal(tmp_path):
    state = {
        "tensors": [torch.tensor(1, dtype=torch.int64), torch.zeros(0, 3), torch.tensor([True])],
        7: (1, 2.5, float("inf"), -0.0, None, True, "text", 2**70),
        "nested": {"empty": {}, "half": torch.tensor([0.1], dtype=torch.bfloat16)},
    }
    saved, loaded = Counter(), Counter()
    saved.state = state
    TrainingCheckpoint(tmp_path).save({"counter": saved}, 0)
    TrainingCheckpoint(tmp_path).load_latest({"counter": loaded})
    torch.testing.assert_close(loaded.state["tensors"], state["tensors"], rtol=0, atol=0)
    assert loaded.state[7] == state[7]
    assert loaded.state["nested"]["empty"] == {}
    assert torch.equal(loaded.state["nested"]["half"], state["nested"]["half"])
    assert loaded.state["tensors"][0].dtype == torch.int64


def test_no_checkpoint_changes_nothing(tmp_path):
    parts = training(0)
    before = torch.get_rng_state()
    assert TrainingCheckpoint(tmp_path / "absent").load_latest(parts) is None
    assert torch.equal(torch.get_rng_state(), before)


@pytest.mark.parametrize("keep", [1, 2])
def test_keeps_the_last_ones(tmp_path, keep):
    checkpoint, counter = TrainingCheckpoint(tmp_path, keep=keep), Counter()
    for iteration in (9, 10, 11):
        counter.state = {"iteration": iteration}
        checkpoint.save({"counter": counter}, iteration)
    assert len(list(tmp_path.iterdir())) == keep
    assert checkpoint.load_latest({"counter": counter}) == 11
    assert counter.state == {"iteration": 11}


@pytest.mark.parametrize("keep", [1, 2])
def test_a_crash_during_save_keeps_the_last_good_one(tmp_path, keep, monkeypatch):
    checkpoint, counter = TrainingCheckpoint(tmp_path, keep=keep), Counter()
    counter.state = {"good": torch.ones(2)}
    checkpoint.save({"counter": counter}, 1)

    counter.state = {"half": torch.zeros(2)}
    with monkeypatch.context() as crash:  # killed: no clean-up code runs
        crash.setattr(Checkpoint, "_publish_path", lambda *_: (_ for _ in ()).throw(SystemExit()))
        crash.setattr(Checkpoint, "_remove_path", lambda *_: None)
        with pytest.raises(SystemExit):
            checkpoint.save({"counter": counter}, 2)
    assert len(list(tmp_path.iterdir())) == 2  # with the stage of the crashed one

    assert checkpoint.load_latest({"counter": counter}) == 1
    assert torch.equal(counter.state["good"], torch.ones(2))
    checkpoint.save({"counter": counter}, 2)
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []


def test_never_unpickles(tmp_path, monkeypatch):
    def refuse(*args, **kwargs):
        raise AssertionError("unpickled")

    parts = training(0)
    advance(parts)
    for name in ("load", "loads", "Unpickler"):
        monkeypatch.setattr(pickle, name, refuse)
    monkeypatch.setattr(torch, "load", refuse)
    TrainingCheckpoint(tmp_path / "run").save(parts, 1)
    assert TrainingCheckpoint(tmp_path / "run").load_latest(training(1)) == 1
    save_weights(tmp_path / "w.safetensors", {"net": parts["net"]}, {})
    load_weights(tmp_path / "w.safetensors", {"net": training(1)["net"]})


def test_refuses_a_checkpoint_in_torchrl_s_own_format(tmp_path):
    counter = Counter()
    TrainingCheckpoint(tmp_path).save({"counter": counter}, 1)
    manifest = next(tmp_path.glob("*/manifest.json"))
    content = json.loads(manifest.read_text())
    content["components"]["counter"]["adapter"] = "torchrl.state_dict"
    manifest.write_text(json.dumps(content))
    with pytest.raises(CheckpointError, match=r"torchrl\.state_dict"):
        TrainingCheckpoint(tmp_path).load_latest({"counter": counter})


def test_refuses_other_components_unknown_values_and_used_directories(tmp_path):
    checkpoint, counter = TrainingCheckpoint(tmp_path), Counter()
    checkpoint.save({"counter": counter}, 5)
    with pytest.raises(ValueError, match=r"holds components \['counter'\], got \['net'\]"):
        checkpoint.load_latest({"net": nn.Linear(1, 1)})
    with pytest.raises(ValueError, match="already holds iteration 5"):
        checkpoint.save({"counter": counter}, 4)
    with pytest.raises(ValueError, match="'rate' is a float"):
        checkpoint.save({"rate": 0.1}, 6)
    counter.state = {"bad": object()}
    with pytest.raises(ValueError, match="holds a object"):
        checkpoint.save({"counter": counter}, 6)
    assert len(list(tmp_path.iterdir())) == 1
