"""Damaged files of every kind are refused by name, or load as what was written: nothing else.

Damage is drawn from a seed, so a failure names the case that repeats it. Two sorts of it: bytes
that are not those that were written, and forgeries, whose digest is right but whose contents are
not what a reader expects (a newer version's file, or someone else's).
"""

import collections
import json
import os
import random
import shutil
import signal
import struct
from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from torch import nn

from pemirl_trl.checkpoint import TrainingCheckpoint, _Sealed
from pemirl_trl.data import DemonstrationDataset, Provenance
from pemirl_trl.files import load_weights, read_tensors, save_weights, write_tensors
from pemirl_trl.modules import ModelConfig, PEMIRLModel
from pemirl_trl.pretrained import load_model, save_model

SECONDS = 10  # more for one file is a hang


# --- what is written and read ------------------------------------------------------------------


@dataclass
class Kind:
    """A kind of file: how to write one, and what reading gives, as something comparable."""

    name: str
    save: Callable[[Path], None]
    load: Callable[[Path], object]


def plain(value):
    """Nested values with tensors as dtype, shape and bytes."""
    if isinstance(value, torch.Tensor):
        raw = value.detach().contiguous().flatten().view(torch.uint8)
        return str(value.dtype), tuple(value.shape), bytes(raw.tolist())
    if isinstance(value, dict):
        return {key: plain(item) for key, item in value.items()}
    return [plain(item) for item in value] if isinstance(value, list | tuple) else value


def save_demonstrations(path):
    task = TensorDict({"goal": torch.randn(4, 2), "deep": {"sign": torch.ones(4).long()}}, [4])
    provenance = Provenance("toy", 3, -1.5, "0.1", "collect", {"note": "ü"})
    DemonstrationDataset(torch.randn(4, 6, 3), torch.randn(4, 5, 2), provenance, task).save(path)


def load_demonstrations(path):
    demos = DemonstrationDataset.load(path)
    task = {} if demos.task is None else demos.task.flatten_keys(".").to_dict()
    return plain([demos.observation, demos.action, task]), demos.provenance


def linear():
    return nn.Linear(3, 3)


def load_linear(path):
    module = linear()
    metadata = load_weights(path, {"net": module})
    return plain(dict(module.state_dict())), metadata


def save_small_model(path):
    sizes = {"context_dim": 2, "encoder_hidden": (4,), "policy_hidden": (4,), "reward_hidden": (4,)}
    save_model(path, PEMIRLModel(3, 2, 4, ModelConfig(**sizes)), {"task": "toy"})


def load_small_model(path):
    model = load_model(path)
    sizes = model.observation_dim, model.action_dim, model.horizon
    return plain(dict(model.state_dict())), sizes, repr(model.config)


def training():
    net = linear()
    adam = torch.optim.Adam(net.parameters())
    net(torch.ones(1, 3)).sum().backward()
    adam.step()
    return {"net": net, "adam": adam}


def load_training(path):
    parts = training()
    iteration = TrainingCheckpoint(path).load_latest(parts)
    return iteration, plain({name: dict(part.state_dict()) for name, part in parts.items()})


KINDS = [
    Kind("demonstrations", save_demonstrations, load_demonstrations),
    Kind("weights", lambda p: save_weights(p, {"net": linear()}, {"task": "toy"}), load_linear),
    Kind("model", save_small_model, load_small_model),
    Kind("checkpoint", lambda p: TrainingCheckpoint(p).save(training(), 3), load_training),
]


# --- damage ------------------------------------------------------------------------------------


def parts_of(path):
    """The header of a safetensors file, and the bytes after it."""
    content = path.read_bytes()
    (size,) = struct.unpack("<Q", content[:8])
    return json.loads(content[8 : 8 + size]), content[8 + size :]


def join(path, header, body):
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + body)


def flip(path, draw):
    content = bytearray(path.read_bytes())
    end = len(content) if draw.random() < 0.5 else min(len(content), 600)  # or in the header
    content[draw.randrange(end)] ^= 1 << draw.randrange(8)
    path.write_bytes(content)


def truncate(path, draw):
    content = path.read_bytes()
    path.write_bytes(content[: draw.randrange(len(content))])


def extend(path, draw):
    path.write_bytes(path.read_bytes() + draw.randbytes(draw.randint(1, 64)))


def blank(path, draw):
    content = bytearray(path.read_bytes())
    start = draw.randrange(len(content))
    end = min(len(content), start + draw.randint(1, 64))
    content[start:end] = bytes(end - start)
    path.write_bytes(content)


def empty(path, _):
    path.write_bytes(b"")


def replace_by(make):
    def replace(path, _):
        path.unlink()
        make(path)

    replace.__name__ = f"replace_by_{make.__name__}"
    return replace


def nothing(_):
    pass


def link_to_itself(path):
    path.symlink_to(path.name)


def absurd_length(path, draw):
    content = path.read_bytes()
    size = draw.choice([0, 1, 2**31, 2**63, 2**64 - 1])
    path.write_bytes(struct.pack("<Q", size) + content[8:])


def nest(path, _):
    _, body = parts_of(path)
    join(path, b'{"x":' * 20_000 + b"1" + b"}" * 20_000, body)


def edit_entry(path, draw):
    """Change what the format says of one tensor."""
    header, body = parts_of(path)
    names = [name for name in header if name != "__metadata__"]
    if not names:
        return flip(path, draw)
    entry, field = header[draw.choice(names)], draw.choice(["dtype", "shape", "data_offsets"])
    entry[field] = {
        "dtype": draw.choice(["F32", "F64", "I32", "BF16", "C64", "F8_E4M3", "F4", "U32", "no", 3]),
        "shape": draw.choice([[], [1], [-1], [2**62, 2**62], entry["shape"][::-1], None]),
        "data_offsets": draw.choice([[0, 0], [0, 2**63], [4, 0], [-1, 3], None, [1]]),
    }[field]
    return join(path, header, body)


def swap_tensors(path, draw):
    header, body = parts_of(path)
    names = [name for name in header if name != "__metadata__"]
    if len(names) < 2:
        return flip(path, draw)
    a, b = draw.sample(names, 2)
    header[a], header[b] = header[b], header[a]
    return join(path, header, body)


def rename(path, draw):
    header, body = parts_of(path)
    name = draw.choice(list(header))
    header[draw.choice(["", "x", "task.x", name + ".y", "__metadata__"])] = header.pop(name)
    join(path, header, body)


def junk(draw):
    return draw.choice([None, True, -1, 0, 2.5, 10**30, "", "x", [], [1], {}, {"x": 1}, "[" * 5000])


def edit_json(value, draw):
    """A copy of nested JSON with one thing changed, dropped or added."""
    value = json.loads(json.dumps(value))
    holder = value
    while True:
        keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
        if not keys or draw.random() < 0.1:
            holder.update(x=junk(draw)) if isinstance(holder, dict) else holder.append(junk(draw))
            return value
        key = draw.choice(keys)
        if not isinstance(holder[key], dict | list) or draw.random() < 0.2:
            break
        holder = holder[key]
    if draw.random() < 0.3:
        del holder[key]
    else:
        holder[key] = junk(draw)
    return value


def edit_facts(path, draw):
    """Change the header that this library wrote, not its digest."""
    header, body = parts_of(path)
    facts = json.loads(header["__metadata__"]["pemirl_trl"])
    header["__metadata__"]["pemirl_trl"] = json.dumps(edit_json(facts, draw))
    join(path, header, body)


def edit_manifest(path, draw):
    path.write_text(json.dumps(edit_json(json.loads(path.read_text()), draw)))


ANY_FILE = (
    *(flip, flip, flip, truncate, extend, blank, empty, absurd_length),
    *(replace_by(make) for make in (Path.mkdir, os.mkfifo, nothing, link_to_itself)),
)
TENSOR_FILE = (edit_entry, edit_entry, swap_tensors, rename, edit_facts, edit_facts, nest)


def damage(path, draw):
    if path.is_dir():  # a checkpoint: one of its files
        path = draw.choice(sorted(file for file in path.rglob("*") if file.is_file()))
    extra = (edit_manifest, edit_manifest) if path.suffix == ".json" else TENSOR_FILE
    change = draw.choice(ANY_FILE + extra)
    change(path, draw)
    return f"{change.__name__} {path.name}"


def forge(path, draw):
    """Other contents, with the digest that belongs to them."""
    sealed = next(path.glob("checkpoint-*")) if path.is_dir() else None
    if sealed:
        path = draw.choice(sorted(path.rglob("state.safetensors")))
    facts = json.loads(parts_of(path)[0]["__metadata__"]["pemirl_trl"])
    tensors, header = read_tensors(path, kind=facts["kind"])
    change = draw.choice(["header", "header", "model", "dtype", "shape", "name", "value", "drop"])
    name = draw.choice(sorted(tensors)) if tensors else None
    if change == "model" and "pemirl_model" in header.get("metadata", {}):
        sizes = json.loads(header["metadata"]["pemirl_model"])
        header["metadata"]["pemirl_model"] = json.dumps(edit_json(sizes, draw))
    elif change == "header" or name is None:
        header = edit_json(header, draw)
    elif change == "dtype":
        dtypes = (torch.float64, torch.int32, torch.bool, torch.complex64, torch.bfloat16)
        tensors[name] = tensors[name].to(draw.choice(dtypes))
    elif change == "shape":
        tensors[name] = draw.choice([tensors[name][None], tensors[name].flatten(), torch.zeros(())])
    elif change == "value":
        tensors[name] = torch.full_like(tensors[name].double(), float("nan"))
    elif change == "drop":
        del tensors[name]
    else:
        tensors[draw.choice(["x", "task.x", "", "model.x", "net.x.y"])] = tensors.pop(name)
    write_tensors(path, tensors, kind=facts["kind"], header=header)
    if sealed:
        (sealed / "seal.safetensors").unlink()
        _Sealed(sealed).seal(3, None)
    return f"forge {change} {path.name}"


# --- the law -----------------------------------------------------------------------------------


@contextmanager
def no_hang(case):
    def stop(*_):
        pytest.fail(f"{case}: no answer after {SECONDS} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(SECONDS)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def outcome(kind, path, original, case):
    """``clear``, ``harmless`` or ``other``; a raw error fails."""
    with no_hang(case):
        try:
            loaded = kind.load(path)
        except (ValueError, OSError) as error:
            if str(path) not in str(error):
                pytest.fail(f"{case}: does not name the file: {error!r}")
            return "clear"
        except Exception as error:
            raise AssertionError(f"{case}: raw {error!r}") from error
    return "harmless" if loaded == original else "other"


def run_cases(kind, folder, cases, harm):
    whole = folder / "whole"
    kind.save(whole)
    original = kind.load(whole)
    counts = collections.Counter(clear=0, harmless=0, other=0)
    for seed in range(cases):
        path = folder / str(seed)
        (shutil.copytree if whole.is_dir() else shutil.copy)(whole, path)
        done = harm(path, random.Random(seed))
        case = f"{kind.name}, seed {seed}, {done}"
        result = outcome(kind, path, original, case)
        if harm is damage:
            assert result != "other", f"{case}: accepted, though it is not what was written"
        counts[result] += 1
    print(f"{kind.name}, {harm.__name__}: tried {cases}, {dict(counts)}")
    assert counts["clear"] > cases / 4, "the damage does nothing"


SIZES = [200, pytest.param(1000, marks=pytest.mark.long)]


@pytest.mark.parametrize("cases", SIZES)
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_damaged_files_are_refused_by_name_or_load_as_they_were(kind, cases, tmp_path):
    run_cases(kind, tmp_path, cases, damage)


@pytest.mark.parametrize("cases", SIZES)
@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_forged_files_are_refused_by_name_or_fit(kind, cases, tmp_path):
    run_cases(kind, tmp_path, cases, forge)
