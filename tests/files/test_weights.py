"""Weights come back as they were saved, into modules that they fit."""

from pathlib import Path

import pytest
import torch
from torch import nn

from pemirl_trl.files import (
    load_weights,
    read_metadata,
    read_weights,
    save_weights,
    write_tensors,
)

ROOT = Path(__file__).parents[2]


def modules():
    return {"q": nn.Linear(2, 3), "r": nn.Sequential(nn.Linear(2, 2), nn.Linear(2, 1))}


def weights_of(parts):
    return {f"{n}.{k}": v.clone() for n, m in parts.items() for k, v in m.state_dict().items()}


def test_weights_round_trip_with_metadata(tmp_path):
    source, target = modules(), modules()
    save_weights(tmp_path / "w.safetensors", source, {"task": "point_maze"})
    assert load_weights(tmp_path / "w.safetensors", target) == {"task": "point_maze"}
    torch.testing.assert_close(weights_of(source), weights_of(target), rtol=0, atol=0)


def test_tied_weights_can_be_saved(tmp_path):
    tied = nn.Linear(2, 2)
    save_weights(tmp_path / "w.safetensors", {"a": tied, "b": tied}, {})
    target = {"a": nn.Linear(2, 2), "b": nn.Linear(2, 2)}
    load_weights(tmp_path / "w.safetensors", target)
    assert torch.equal(target["a"].weight, tied.weight)
    assert torch.equal(target["b"].weight, tied.weight)


def test_one_module_of_several_can_be_loaded(tmp_path):
    source, target = modules(), {"q": nn.Linear(2, 3)}
    save_weights(tmp_path / "w.safetensors", source, {})
    load_weights(tmp_path / "w.safetensors", target)
    assert torch.equal(target["q"].weight, source["q"].weight)


@pytest.mark.parametrize(
    ("replace", "message"),
    [
        ({"r": nn.Linear(2, 1)}, r"missing r\.bias; missing r\.weight; unexpected r\.0\.bias"),
        ({"r": nn.Sequential(nn.Linear(2, 2), nn.Linear(2, 5))}, r"r\.1\.bias is \(1,\)"),
        ({"h": nn.Linear(2, 1)}, r"missing h\.bias; missing h\.weight"),
        ({"r": modules()["r"].double()}, r"r\.0\.bias is \(2,\) torch\.float32, expected"),
    ],
)
def test_a_mismatch_is_named_before_anything_changes(tmp_path, replace, message):
    save_weights(tmp_path / "w.safetensors", modules(), {})
    target = modules() | replace
    before = weights_of(target)
    with pytest.raises(ValueError, match=message):
        load_weights(tmp_path / "w.safetensors", target)
    torch.testing.assert_close(weights_of(target), before, rtol=0, atol=0)


def test_a_file_of_version_1_still_loads():
    expert = ROOT / "data" / "point_maze_left_expert.safetensors"
    assert read_metadata(expert)["environment"] == "point_maze/left"
    tensors, _ = read_weights(expert)
    assert tensors["policy.module.0.net.log_scale"].shape == (2,)


def test_metadata_other_than_strings_is_refused(tmp_path):
    with pytest.raises(ValueError, match="'steps' is 3; expected str"):
        save_weights(tmp_path / "w", modules(), {"steps": 3})
    assert list(tmp_path.iterdir()) == []
    write_tensors(tmp_path / "w", {}, kind="weights", header={"metadata": {"steps": 3}})
    with pytest.raises(ValueError, match=r"metadata of .*/w: 'steps' is 3; expected str"):
        read_metadata(tmp_path / "w")
    write_tensors(tmp_path / "w", {}, kind="weights", header={})
    with pytest.raises(ValueError, match=r"header of .*/w lacks the fields \['metadata'\]"):
        load_weights(tmp_path / "w", {})
