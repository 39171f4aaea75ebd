"""Files are whole or absent, say what they are, and come back as they were written."""

import pytest
import torch
from safetensors.torch import save_file
from torch import nn

from pemirl_trl.files import atomic_path, load_weights, read_tensors, save_weights, write_tensors


def test_atomic_path_replaces_whole_or_not_at_all(tmp_path):
    target = tmp_path / "deep" / "a.json"
    with atomic_path(target) as temporary:
        temporary.write_text("old")

    def fail_half_way():
        with atomic_path(target) as temporary:
            temporary.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail_half_way()
    assert target.read_text() == "old"
    assert [p.name for p in target.parent.iterdir()] == ["a.json"]


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


def test_wrong_files_say_what_they_are(tmp_path):
    path = tmp_path / "w.safetensors"
    with pytest.raises(FileNotFoundError, match="no weights file"):
        read_tensors(path, kind="weights")
    path.write_bytes(b"not tensors")
    with pytest.raises(ValueError, match="not a readable safetensors file"):
        read_tensors(path, kind="weights")
    save_file({"x": torch.ones(1)}, path)
    with pytest.raises(ValueError, match=r"tensors \['x'\], but pemirl_trl did not write it"):
        read_tensors(path, kind="weights")
    write_tensors(path, {"x": torch.ones(1)}, kind="demonstrations", header={})
    with pytest.raises(ValueError, match="holds 'demonstrations'"):
        read_tensors(path, kind="weights")


def test_one_flipped_bit_is_noticed(tmp_path):
    path = tmp_path / "w.safetensors"
    write_tensors(path, {"x": torch.ones(4)}, kind="weights", header={})
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    with pytest.raises(ValueError, match="damaged"):
        read_tensors(path, kind="weights")
