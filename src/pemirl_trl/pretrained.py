"""Whole models in one file: to share, and to read rewards from."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from pemirl_trl.files import load_weights, read_metadata, save_weights
from pemirl_trl.modules import ModelConfig, PEMIRLModel


def save_model(
    path: str | Path, model: PEMIRLModel, metadata: Mapping[str, str] | None = None
) -> None:
    """Write a model, its sizes and ``metadata`` to one safetensors file, atomically."""
    sizes = {
        "observation_dim": model.observation_dim,
        "action_dim": model.action_dim,
        "horizon": model.horizon,
        "config": asdict(model.config),
    }
    facts = {**(metadata or {}), "pemirl_model": json.dumps(sizes)}
    save_weights(path, {"model": model}, facts)


def load_model(path: str | Path) -> PEMIRLModel:
    """Rebuild a model from the file of :func:`save_model`; nothing is unpickled.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file holds something else.
    """
    metadata = read_metadata(path)
    if "pemirl_model" not in metadata:
        raise ValueError(f"{path} holds weights {sorted(metadata)}, expected those of a model")
    sizes = json.loads(metadata["pemirl_model"])
    model = PEMIRLModel(
        sizes["observation_dim"],
        sizes["action_dim"],
        sizes["horizon"],
        ModelConfig(**sizes["config"]),
    )
    load_weights(path, {"model": model})
    return model
