"""Tensors and headers come back as they were written, or not at all."""

import json
import os

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file

from pemirl_trl.files import read_tensors, write_tensors

HEADER = {"count": 3, "names": ["a", "b"], "nested": {"x": [1.5, None, True, 1e300]}, "ü": "é"}


def write(path, tensors=None, header=HEADER):
    write_tensors(path, tensors or {"x": torch.ones(4)}, kind="toy", header=header)


def rewrite(path, change):
    """Change the facts in the header, and leave the rest as it is."""
    with safe_open(path, framework="pt") as file:
        facts = json.loads(file.metadata()["pemirl_trl"])
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    facts = change(facts)
    text = facts if isinstance(facts, str) else json.dumps(facts)
    save_file(tensors, path, metadata={"pemirl_trl": text})


def test_round_trip_of_every_dtype(tmp_path):
    dtypes = (torch.float32, torch.float64, torch.bfloat16, torch.int64, torch.bool, torch.uint8)
    tensors = {str(dtype): torch.arange(6).reshape(2, 3).to(dtype) for dtype in dtypes}
    tensors |= {"empty": torch.zeros(0, 3), "scalar": torch.tensor(1.0)}
    write(tmp_path / "x", tensors)
    read, header = read_tensors(tmp_path / "x", kind="toy")
    assert header == HEADER
    assert read.keys() == tensors.keys()
    for name, value in tensors.items():
        assert read[name].dtype == value.dtype
        assert torch.equal(read[name], value)
    assert os.stat(tmp_path / "x").st_mode & 0o777 == 0o666 & ~current_umask()


def current_umask():
    umask = os.umask(0)
    os.umask(umask)
    return umask


def test_wrong_files_say_what_they_are(tmp_path):
    path = tmp_path / "x"
    with pytest.raises(FileNotFoundError, match=r"no toy file.*/x'"):
        read_tensors(path, kind="toy")
    path.write_bytes(b"not tensors")
    with pytest.raises(ValueError, match="x is not a readable safetensors file"):
        read_tensors(path, kind="toy")
    save_file({"x": torch.ones(1)}, path)
    with pytest.raises(ValueError, match=r"tensors \['x'\], but pemirl_trl did not write it"):
        read_tensors(path, kind="toy")
    write_tensors(path, {"x": torch.ones(1)}, kind="demonstrations", header={})
    with pytest.raises(ValueError, match="holds 'demonstrations'"):
        read_tensors(path, kind="toy")


def test_one_flipped_bit_is_noticed(tmp_path):
    path = tmp_path / "x"
    write(path)
    content = bytearray(path.read_bytes())
    content[-1] ^= 1
    path.write_bytes(content)
    with pytest.raises(ValueError, match="x is damaged: its contents do not match"):
        read_tensors(path, kind="toy")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda f: {**f, "header": {**f["header"], "count": 4}}, "contents do not match"),
        (lambda f: {**f, "version": 1}, "contents do not match"),
        (lambda f: {**f, "version": 3}, "file version 3; expected 'toy', file version 1 or 2"),
        (lambda f: {**f, "version": "2"}, "'version' is '2'; expected int"),
        (lambda f: {**f, "header": [1]}, r"'header' is \[1\]; expected dict"),
        (lambda f: {k: v for k, v in f.items() if k != "sha256"}, r"lacks the fields \['sha256'\]"),
        (lambda f: {**f, "more": 1}, r"unknown ones \['more'\]"),
        (lambda f: [f], "is a list; expected the fields"),
        (lambda f: json.dumps(f)[:-5], "not JSON"),
        (lambda f: "[" * 100_000, "not JSON"),
    ],
)
def test_an_edited_header_is_refused_by_name(tmp_path, change, message):
    write(tmp_path / "x")
    rewrite(tmp_path / "x", change)
    with pytest.raises(ValueError, match=message) as raised:
        read_tensors(tmp_path / "x", kind="toy")
    assert str(tmp_path / "x") in str(raised.value)


def test_the_test_s_own_rewriting_is_harmless(tmp_path):
    write(tmp_path / "x")
    rewrite(tmp_path / "x", lambda facts: facts)
    assert read_tensors(tmp_path / "x", kind="toy")[1] == HEADER


def test_a_header_that_is_no_json_is_refused(tmp_path):
    with pytest.raises(ValueError, match="x is not written: its header is not JSON"):
        write(tmp_path / "x", header={"path": tmp_path})
    assert list(tmp_path.iterdir()) == []
