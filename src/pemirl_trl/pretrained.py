"""Whole models in one file: to share, and to read rewards from."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from pemirl_trl.files import (
    check_fields,
    load_weights,
    misfits,
    parse_json,
    read_weights,
    save_weights,
)
from pemirl_trl.modules import ModelConfig, PEMIRLModel, Standardize, TrainingFamily

_SIZES = {"observation_dim": int, "action_dim": int, "horizon": int, "config": dict}
_CONFIG: dict[str, type | tuple[type, ...]] = {
    "context_dim": int,
    "encoder": str,
    "reward": str,
    "encoder_hidden": list,
    "policy_hidden": list,
    "reward_hidden": list,
    "reward_gamma": (int, float),
    "policy_scale": (int, float),
    "reward_features": (list, type(None)),
    "absorbing": bool,
}


def save_model(
    path: str | Path, model: PEMIRLModel, metadata: Mapping[str, str] | None = None
) -> None:
    """Write a model, its sizes and ``metadata`` to one safetensors file, atomically.

    Raises:
        OSError: it cannot be written; the message names the file and says what to do.
    """
    sizes = {
        "observation_dim": model.observation_dim,
        "action_dim": model.action_dim,
        "horizon": model.horizon,
        "config": asdict(model.config),
    }
    facts = {**(metadata or {}), "pemirl_model": json.dumps(sizes)}
    if model.family is not None:
        facts["training_family"] = json.dumps(_stated(model.family))
    save_weights(path, {"model": model}, facts)


def load_model(path: str | Path) -> PEMIRLModel:
    """Rebuild a model from the file of :func:`save_model`; nothing is unpickled.

    The sizes in the header are compared with the tensors before any network of theirs is made.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file holds something else, is damaged, or contradicts itself.
    """
    tensors, metadata = read_weights(path)
    if "pemirl_model" not in metadata:
        raise ValueError(f"{path} holds weights {sorted(metadata)}, expected those of a model")
    what = f"the sizes of the model in {path}"
    sizes = check_fields(parse_json(metadata["pemirl_model"], what), _SIZES, what)
    optional = [field.name for field in fields(ModelConfig)]  # an older file has fewer
    check_fields(sizes["config"], _CONFIG, what, optional=optional)
    _compare(sizes, tensors, path)
    model = _build(sizes)
    load_weights(path, {"model": model})
    if "training_family" in metadata:  # an older file does not say
        model.family = _family(metadata["training_family"], model, path)
    return model


def _stated(family: TrainingFamily) -> dict[str, Any]:
    return {
        name: value.tolist() if isinstance(value, Tensor) else value
        for name, value in vars(family).items()
    }


def _family(text: str, model: PEMIRLModel, path: str | Path) -> TrainingFamily:
    """Statistics of the training demonstrations, of the model's sizes."""
    what = f"the training family in {path}"
    numbers = {"context_distance": (int, float)}
    kinds = {f.name: numbers.get(f.name, list) for f in fields(TrainingFamily)}
    stated = check_fields(parse_json(text, what), kinds, what)
    d, s = model.config.context_dim, model.observation_dim
    shapes: dict[str, tuple[int, ...]] = {"context_mean": (d,), "context_covariance": (d, d)}
    tensors: dict[str, Tensor] = {}
    for name in kinds.keys() - numbers.keys():
        shape = shapes.get(name, (s,))
        try:
            tensors[name] = torch.tensor(stated[name], dtype=torch.get_default_dtype())
        except (TypeError, ValueError, RuntimeError) as error:
            raise ValueError(f"{what} is damaged: {name} holds no numbers ({error})") from error
        if tensors[name].shape != shape or not torch.isfinite(tensors[name]).all():
            raise ValueError(f"{what} is damaged: expected {name} of finite numbers {list(shape)}")
    return TrainingFamily(context_distance=float(stated["context_distance"]), **tensors)


def _build(sizes: Mapping[str, Any], standardize: Standardize | None = None) -> PEMIRLModel:
    return PEMIRLModel(
        sizes["observation_dim"],
        sizes["action_dim"],
        sizes["horizon"],
        ModelConfig(**sizes["config"]),
        standardize,
    )


def _compare(sizes: Mapping[str, Any], tensors: Mapping[str, Tensor], path: str | Path) -> None:
    """Raise ValueError unless ``sizes`` are those of ``tensors``; allocates nothing.

    A network on the device ``meta`` has shapes and no memory. The map of observations is taken
    from the file: it looks at its values.
    """
    widths = (v for name, v in sizes["config"].items() if name.endswith("_hidden"))
    hidden = [width for layers in widths for width in layers]
    counts = [sizes["observation_dim"], sizes["action_dim"], sizes["horizon"], *hidden]
    if any(type(count) is not int or count < 1 for count in counts) or len(hidden) > len(tensors):
        raise ValueError(
            f"{path} is damaged: its model has the sizes {counts!s:.200}; expected positive "
            f"ones, and no more than {len(tensors)} layers for as many tensors"
        )
    try:
        standardize = Standardize(
            tensors["model.standardize.loc"], tensors["model.standardize.scale"]
        )
        if standardize.features != sizes["observation_dim"]:
            raise ValueError(f"its map of observations has {standardize.features} features")
        with torch.device("meta"):
            expected = _build(sizes, standardize).state_dict()
    except (KeyError, TypeError, ValueError, IndexError, OverflowError, RuntimeError) as error:
        raise ValueError(
            f"{path} is damaged: no model has its sizes {dict(sizes)!s:.200} ({error})"
        ) from error
    if problems := misfits(tensors, {f"model.{key}": value for key, value in expected.items()}):
        raise ValueError(
            f"{path} is damaged: its tensors are not those of a model of its sizes: "
            + "; ".join(problems[:8])
        )
