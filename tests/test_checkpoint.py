"""A resumed run continues bit for bit; a crash costs nothing; nothing is unpickled."""

import errno
import json
import os
import pickle
import random
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn
from torchrl.checkpoint import Checkpoint

from pemirl_trl.checkpoint import TrainingCheckpoint, UnusableCheckpointWarning
from pemirl_trl.files import load_weights, read_tensors, save_weights, write_tensors
from pemirl_trl.files.staging import _MACHINE

GOLDEN = Path(__file__).parent / "golden" / "file_version_1"


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
def test_a_failure_during_save_keeps_the_last_good_one(tmp_path, keep, monkeypatch):
    checkpoint, counter = TrainingCheckpoint(tmp_path, keep=keep), Counter()
    counter.state = {"good": torch.ones(2)}
    checkpoint.save({"counter": counter}, 1)

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    counter.state = {"half": torch.zeros(2)}
    with monkeypatch.context() as disk:
        disk.setattr(Checkpoint, "_new_manifest", full)
        with pytest.raises(OSError, match=r"free some space.*checkpoint-000000000002'") as raised:
            checkpoint.save({"counter": counter}, 2)
    assert raised.value.errno == errno.ENOSPC
    assert [p.name for p in tmp_path.iterdir()] == ["checkpoint-000000000001"]
    assert checkpoint.load_latest({"counter": counter}) == 1
    assert torch.equal(counter.state["good"], torch.ones(2))


KILLED = """
import os, signal, sys
from torch import nn
from pemirl_trl import checkpoint
part = {"net": nn.Linear(1, 1)}
run = checkpoint.TrainingCheckpoint(sys.argv[1])
run.save(part, 1)
checkpoint._Sealed.seal = lambda *_: os.kill(os.getpid(), signal.SIGKILL)
run.save(part, 2)
"""


def test_what_a_killed_process_staged_is_removed_and_a_live_one_s_stays(tmp_path):
    path = os.pathsep.join(filter(None, sys.path))
    command = [sys.executable, "-W", "ignore", "-c", KILLED, str(tmp_path)]
    killed = subprocess.run(
        command, env={**os.environ, "PYTHONPATH": path}, capture_output=True, check=False
    )
    assert killed.returncode == -signal.SIGKILL, killed.stderr.decode()
    assert len(list(tmp_path.iterdir())) == 2
    (tmp_path / ".checkpoint-000000000002.stage-0123").mkdir()  # as earlier versions named it
    alive = tmp_path / f".checkpoint-{_MACHINE}-{os.getppid()}-0123abcd"
    alive.mkdir()

    checkpoint, part = TrainingCheckpoint(tmp_path), {"net": nn.Linear(1, 1)}
    assert checkpoint.load_latest(part) == 1
    checkpoint.save(part, 2)
    assert {p.name for p in tmp_path.iterdir()} == {
        "checkpoint-000000000001",
        "checkpoint-000000000002",
        alive.name,
    }


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
    shutil.copytree(GOLDEN / "run", tmp_path / "run")
    manifest = next(tmp_path.glob("run/*/manifest.json"))
    content = json.loads(manifest.read_text())
    content["components"]["net"]["adapter"] = "torchrl.state_dict"
    manifest.write_text(json.dumps(content))
    with pytest.raises(ValueError, match=r"does not fit its components: .*torchrl\.state_dict"):
        TrainingCheckpoint(tmp_path / "run").load_latest(old_training())


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


# --- whole, or not used ------------------------------------------------------------------------


def saved(folder, iterations=(1, 2), **arguments):
    """Checkpoints of a counter whose state tells the iteration; return the newest's folder."""
    checkpoint, counter = TrainingCheckpoint(folder, **arguments), Counter()
    for iteration in iterations:
        counter.state = {"iteration": iteration, "tensor": torch.full((3,), float(iteration))}
        newest = checkpoint.save({"counter": counter}, iteration)
    return newest


def edit(name, old, new):
    def change(folder):
        file = folder / name
        content = file.read_bytes()
        assert old in content, "nothing to edit"
        file.write_bytes(content.replace(old, new))

    return change


STATE = "components/0000-counter/state.safetensors"
DAMAGES = {
    "an emptied manifest": lambda folder: (folder / "manifest.json").write_text(""),
    "a manifest without content": lambda folder: (folder / "manifest.json").write_text("{}"),
    "a manifest of a list": lambda folder: (folder / "manifest.json").write_text("[]"),
    "no manifest": lambda folder: (folder / "manifest.json").unlink(),
    "another iteration": edit("manifest.json", b'"iteration": 2', b'"iteration": 7'),
    "another iteration in the seal": edit("seal.safetensors", b": 2, ", b": 7, "),
    "an emptied seal": lambda folder: (folder / "seal.safetensors").write_text(""),
    "no seal": lambda folder: (folder / "seal.safetensors").unlink(),
    "a changed number in the state": edit(STATE, b'iteration\\", 2', b'iteration\\", 3'),
    "a changed tensor": edit(STATE, b"\x00\x00\x00@", b"\x00\x00\x01@"),
    "no state": lambda folder: (folder / STATE).unlink(),
    "an older state": lambda folder: shutil.copy(
        folder.with_name("checkpoint-000000000001") / STATE, folder / STATE
    ),
    "a folder": lambda folder: [p.unlink() for p in folder.rglob("*") if p.is_file()],
    "a file": lambda folder: (shutil.rmtree(folder), folder.write_text("")),
    "a wrong number": lambda folder: folder.rename(folder.with_name("checkpoint-000000000009")),
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES.keys())
def test_the_one_before_a_damaged_checkpoint_is_used_and_both_are_named(tmp_path, damage):
    damage(saved(tmp_path))
    checkpoint, counter = TrainingCheckpoint(tmp_path), Counter()
    with pytest.warns(
        UnusableCheckpointWarning,
        match=r"continued from checkpoint-000000000001; not usable: checkpoint-00000000000[29]: .*",
    ):
        assert checkpoint.load_latest({"counter": counter}) == 1
    assert counter.state["iteration"] == 1
    assert torch.equal(counter.state["tensor"], torch.ones(3))
    checkpoint.save({"counter": counter}, 2)  # in the place of the damaged one
    assert sorted(p.name[-1] for p in tmp_path.iterdir()) == ["1", "2"]
    assert TrainingCheckpoint(tmp_path).load_latest({"counter": counter}) == 2


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES.keys())
def test_without_a_usable_checkpoint_nothing_starts_anew(tmp_path, damage):
    newest = saved(tmp_path / "run")
    older = newest.with_name("checkpoint-000000000001")
    kept = tmp_path / "older" / older.name
    shutil.copytree(older, kept)
    damage(newest)
    shutil.rmtree(older)
    counter = Counter()
    with pytest.raises(ValueError, match=r"no checkpoint in .*run is usable: .*start anew"):
        TrainingCheckpoint(tmp_path / "run").load_latest({"counter": counter})
    assert counter.state == {}
    shutil.copytree(kept, older)  # as the message says
    with pytest.warns(UnusableCheckpointWarning):
        assert TrainingCheckpoint(tmp_path / "run").load_latest({"counter": counter}) == 1


def test_a_damaged_later_checkpoint_does_not_stop_the_run_from_saving(tmp_path):
    (saved(tmp_path, (1, 50), keep=2) / "manifest.json").write_text("")
    checkpoint, counter = TrainingCheckpoint(tmp_path, keep=1), Counter()
    with pytest.warns(UnusableCheckpointWarning):
        checkpoint.load_latest({"counter": counter})
    checkpoint.save({"counter": counter}, 2)
    assert TrainingCheckpoint(tmp_path).load_latest({"counter": counter}) == 2


def test_a_checkpoint_of_another_run_is_refused(tmp_path):
    saved(tmp_path, identity="seed 1")
    counter = Counter()
    with pytest.raises(ValueError, match=r"is of the run 'seed 1'; expected 'seed 2'\. Choose"):
        TrainingCheckpoint(tmp_path, "seed 2").load_latest({"counter": counter})
    assert counter.state == {}
    for identity in ("seed 1", None):
        assert TrainingCheckpoint(tmp_path, identity).load_latest({"counter": counter}) == 2


def old_training():
    net = nn.Linear(3, 2)
    return {"net": net, "adam": torch.optim.Adam(net.parameters(), lr=1e-2)}


def test_a_checkpoint_of_file_version_1_still_loads(tmp_path):
    shutil.copytree(GOLDEN / "run", tmp_path / "run")
    parts = old_training()
    assert TrainingCheckpoint(tmp_path / "run", identity="any").load_latest(parts) == 3
    stored, _ = read_tensors(next(tmp_path.glob("run/*/*/0002-net/*")), kind="state")
    assert torch.equal(parts["net"].weight, stored["0"])
    assert len(parts["adam"].state_dict()["state"]) == 2


@pytest.mark.parametrize(
    "damage",
    [
        lambda folder: (folder / "manifest.json").write_text("{}"),
        edit("manifest.json", b'"iteration": 3', b'"iteration": 4'),
        edit("components/0002-net/state.safetensors", b"mapping", b"nothing"),
        lambda folder: (folder / "components/0000-adam/state.safetensors").unlink(),
        lambda folder: write_tensors(
            folder / "components/0002-net/state.safetensors", {}, kind="state", header={}
        ),
    ],
)
def test_a_damaged_one_of_file_version_1_is_refused_before_anything_changes(tmp_path, damage):
    shutil.copytree(GOLDEN / "run", tmp_path / "run")
    damage(next(tmp_path.glob("run/*")))
    parts = old_training()
    before = parts["net"].weight.clone()
    with pytest.raises(ValueError, match=r"no checkpoint in .* is usable"):
        TrainingCheckpoint(tmp_path / "run").load_latest(parts)
    assert torch.equal(parts["net"].weight, before)


def test_a_component_of_other_sizes_is_refused_by_name(tmp_path):
    TrainingCheckpoint(tmp_path).save({"net": nn.Linear(2, 2)}, 1)
    with pytest.raises(ValueError, match=r"(?s)checkpoint-000000000001 does not fit .*'net'.*size"):
        TrainingCheckpoint(tmp_path).load_latest({"net": nn.Linear(3, 2)})


def test_home_is_expanded(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    saved("~/run")
    assert (tmp_path / "run" / "checkpoint-000000000002").is_dir()


def test_keeping_none_is_refused(tmp_path):
    with pytest.raises(ValueError, match="keep is 0; expected at least 1"):
        TrainingCheckpoint(tmp_path, keep=0)
