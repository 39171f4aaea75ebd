"""A folder as ``huggingface_hub.PyTorchModelHubMixin`` writes and reads it, without that package.

``config.json`` holds the arguments of the constructor, ``model.safetensors`` the weights as
``safetensors.torch.save_model`` writes them: tensors that modules share stand there once.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save_model
from torch import Tensor, nn

from pemirl_trl.files import (
    Card,
    atomic_path,
    check_fields,
    file_digest,
    parse_json,
    regular_file,
)
from pemirl_trl.pretrained import compare, parse_sizes

_WEIGHTS = "model.safetensors"
_DIGEST = "sha256"
_OPTIONAL = (dict, type(None))


def write_folder(
    folder: Path, module: nn.Module, config: Mapping[str, Any], card: Card | None
) -> None:
    """Write a module's weights, then its ``config`` with their digest, each file atomically."""
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_path(folder / _WEIGHTS) as temporary:
        save_model(module, str(temporary))
    facts = {**config, _DIGEST: file_digest(folder / _WEIGHTS)}
    with atomic_path(folder / "config.json") as temporary:
        temporary.write_text(json.dumps(facts, indent=2, sort_keys=True) + "\n", encoding="utf-8")
    if card is not None:
        with atomic_path(folder / "README.md") as temporary:
            temporary.write_text(card.markdown(card.domain), encoding="utf-8")


def read_folder(folder: Path, names: Sequence[str]) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """Read the arguments called ``names``, and the weights by name, shared ones included.

    Fields of ``config.json`` other than these are left to other programs: a hub may write some.
    Where the weights' digest is there, it has to be theirs; the mixin writes none.

    Raises:
        FileNotFoundError, ValueError: as ``PortableReward.from_pretrained``.
    """
    file = regular_file(folder / "config.json", "configuration")
    content = parse_json(file.read_text(encoding="utf-8"), str(file))
    if not isinstance(content, dict):
        raise ValueError(f"{file} is a {type(content).__name__}; expected the fields {names}")
    config = {name: content.get(name) for name in names}
    check_fields(config, {n: dict if n == "sizes" else _OPTIONAL for n in names}, str(file))
    sizes = parse_sizes(json.dumps(config["sizes"]), f"the sizes in {file}")
    weights = regular_file(folder / _WEIGHTS, "weights")
    if content.get(_DIGEST, file_digest(weights)) != file_digest(weights):
        raise ValueError(
            f"{weights} is damaged: its SHA-256 is not the one in {file}; copy both anew"
        )
    tensors = _all_tensors(weights)
    compare(sizes, {f"model.{k}": v for k, v in tensors.items()}, weights, "policy")
    return config, tensors


def _all_tensors(weights: Path) -> dict[str, Tensor]:
    """Tensors by name; the metadata tells which one of another name a shared tensor is."""
    try:
        with safe_open(weights, framework="pt") as file:
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            others = file.metadata() or {}
    except SafetensorError as error:
        raise ValueError(f"{weights} is not a readable safetensors file ({error})") from error
    return tensors | {name: tensors[kept] for name, kept in others.items() if kept in tensors}
