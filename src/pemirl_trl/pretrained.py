"""Whole models in one file: to share, and to read rewards from."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from pemirl_trl.files import (
    Card,
    check_fields,
    expanded,
    load_weights,
    misfits,
    parse_card,
    parse_json,
    read_metadata,
    read_weights,
    save_weights,
)
from pemirl_trl.modules import ModelConfig, PEMIRLModel, Standardize, TrainingFamily

_SIZES = {"observation_dim": int, "action_dim": int, "horizon": int, "config": dict}
_CONFIG: dict[str, type | tuple[type, ...]] = {
    "context_dim": int,
    "encoder": str,
    "encoder_reads": str,
    "reward": str,
    "encoder_hidden": list,
    "policy_hidden": list,
    "reward_hidden": list,
    "reward_gamma": (int, float),
    "policy_scale": (int, float),
    "reward_features": (list, type(None)),
    "absorbing": bool,
    "actions": str,
}


_HERE = Path(__file__).resolve()
_ZOO = (_HERE.parent / "zoo", _HERE.parents[2] / "zoo")
"""The wheel's models, and those of a checkout."""


def zoo() -> list[str]:
    """Names of the models that :func:`load_model` knows here: the wheel's, or a checkout's."""
    return sorted({file.stem for folder in _ZOO for file in folder.glob("*.safetensors")})


def model_file(name: str | Path) -> Path:
    """The file that a path, or else a name of :func:`zoo`, means.

    Raises:
        FileNotFoundError: there is neither; lists the names.
    """
    path = expanded(name)
    if path.exists() and not (path.is_dir() and str(name) in zoo()):
        return path
    if str(name) in zoo():
        files = (folder / f"{name}.safetensors" for folder in _ZOO)
        return next(file for file in files if file.exists())
    raise FileNotFoundError(
        f"no file {path}, and no model of this name; there are {', '.join(zoo()) or 'none'} (the "
        "package itself brings point_maze, a checkout of the repository the others)"
    )


def save_model(
    path: str | Path,
    model: PEMIRLModel,
    metadata: Mapping[str, str] | None = None,
    *,
    card: Card | None = None,
) -> None:
    """Write a model, its sizes, its card and ``metadata`` to one safetensors file, atomically.

    Raises:
        OSError: it cannot be written; the message names the file and says what to do.
    """
    facts = {**(metadata or {}), "pemirl_model": json.dumps(sizes_of(model))}
    save_weights(path, {"model": model}, facts | stated(model.family, card))


def load_model(path: str | Path) -> PEMIRLModel:
    """Rebuild a model from the file of :func:`save_model`; nothing is unpickled.

    The sizes in the header are compared with the tensors before any network of theirs is made.

    Args:
        path: a file, or the name of a model of the zoo, such as ``"point_maze"``.

    Raises:
        FileNotFoundError: there is no such file, and no model of this name; lists the names.
        ValueError: the file holds something else, is damaged, or contradicts itself.

    Example:
        >>> load_model("point_maze").observation_dim
        2
    """
    path = model_file(path)
    tensors, metadata = read_weights(path)
    if "pemirl_reward" in metadata:
        raise ValueError(f"{path} holds a reward without a policy: pemirl_trl.load_reward reads it")
    if "pemirl_model" not in metadata:
        raise ValueError(f"{path} holds weights {sorted(metadata)}, expected those of a model")
    sizes = parse_sizes(metadata["pemirl_model"], f"the sizes of the model in {path}")
    compare(sizes, tensors, path)
    model = build_model(sizes)
    load_weights(path, {"model": model})
    if "training_family" in metadata:  # an older file does not say
        what = f"the training family in {path}"
        stated_family = parse_json(metadata["training_family"], what)
        model.family = parse_family(stated_family, sizes, what)
    return model


def load_card(path: str | Path) -> Card:
    """Read the card of a model or a reward.

    Args:
        path: a file, or the name of a model of the zoo.

    Raises:
        FileNotFoundError, ValueError: as :func:`load_model`; or the file has no card.
    """
    path = model_file(path)
    metadata = read_metadata(path)
    if "card" not in metadata:
        raise ValueError(f"{path} has no card; pemirl export_model makes a file that has one")
    what = f"the card of {path}"
    return parse_card(parse_json(metadata["card"], what), what)


# --- what files of models and of rewards share ---------------------------------------------------


def sizes_of(model: PEMIRLModel) -> dict[str, Any]:
    """What :func:`build_model` needs, as JSON has it."""
    return {
        "observation_dim": model.observation_dim,
        "action_dim": model.action_dim,
        "horizon": model.horizon,
        "config": asdict(model.config),
    }


def parse_sizes(text: str, what: str) -> dict[str, Any]:
    """The sizes that a header states, of the types that they have.

    Raises:
        ValueError: not JSON, or other fields; names ``what``.
    """
    sizes = check_fields(parse_json(text, what), _SIZES, what)
    optional = [field.name for field in fields(ModelConfig)]  # an older file has fewer
    check_fields(sizes["config"], _CONFIG, what, optional=optional)
    return sizes


def stated(family: TrainingFamily | None, card: Card | None) -> dict[str, str]:
    """The entries of a header that tell of a family and of a card, where there are some."""
    facts = {}
    if family is not None:
        facts["training_family"] = json.dumps(state_family(family))
    if card is not None:
        facts["card"] = json.dumps(card.json())
    return facts


def state_family(family: TrainingFamily) -> dict[str, Any]:
    """A family as JSON has it; :func:`parse_family` reads it."""
    return {
        name: value.tolist() if isinstance(value, Tensor) else value
        for name, value in vars(family).items()
    }


def parse_family(content: Any, sizes: Mapping[str, Any], what: str) -> TrainingFamily:
    """Statistics of the training demonstrations, of a model's sizes.

    Raises:
        ValueError: other fields, or other than finite numbers of these sizes; names ``what``.
    """
    measured = ("recovered", "outdone", "displaced")
    numbers: dict[str, tuple[type, ...]] = {"context_distance": (int, float)}
    numbers |= dict.fromkeys(measured, (int, float, type(None)))
    kinds = {f.name: numbers.get(f.name, list) for f in fields(TrainingFamily)}
    given = check_fields(content, kinds, what, optional=measured)  # an older file has none
    d, s = ModelConfig(**sizes["config"]).context_dim, sizes["observation_dim"]
    shapes: dict[str, tuple[int, ...]] = {"context_mean": (d,), "context_covariance": (d, d)}
    tensors: dict[str, Tensor] = {}
    for name in kinds.keys() - numbers.keys():
        shape = shapes.get(name, (s,))
        try:
            tensors[name] = torch.tensor(given[name], dtype=torch.get_default_dtype())
        except (TypeError, ValueError, RuntimeError) as error:
            raise ValueError(f"{what} is damaged: {name} holds no numbers ({error})") from error
        if tensors[name].shape != shape or not torch.isfinite(tensors[name]).all():
            raise ValueError(f"{what} is damaged: expected {name} of finite numbers {list(shape)}")
    found = {name: given[name] for name in numbers if given.get(name) is not None}
    if not all(math.isfinite(value) for value in found.values()):
        raise ValueError(f"{what} is damaged: expected finite numbers, got {found}")
    values: dict[str, Any] = {**tensors, **{name: float(value) for name, value in found.items()}}
    return TrainingFamily(**values)


def build_model(sizes: Mapping[str, Any], standardize: Standardize | None = None) -> PEMIRLModel:
    """A fresh model of the sizes of :func:`sizes_of`."""
    return PEMIRLModel(
        sizes["observation_dim"],
        sizes["action_dim"],
        sizes["horizon"],
        ModelConfig(**sizes["config"]),
        standardize,
    )


def compare(
    sizes: Mapping[str, Any],
    tensors: Mapping[str, Tensor],
    path: str | Path,
    without: str | None = None,
) -> None:
    """Raise ValueError unless ``sizes`` are those of ``tensors``; allocates nothing.

    A network on the device ``meta`` has shapes and no memory. The map of observations is taken
    from the file: it looks at its values. The part of the model called ``without`` is not there.
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
            state = build_model(sizes, standardize).state_dict()
            expected = {k: v for k, v in state.items() if k.split(".")[0] != without}
    except (KeyError, TypeError, ValueError, IndexError, OverflowError, RuntimeError) as error:
        raise ValueError(
            f"{path} is damaged: no model has its sizes {dict(sizes)!s:.200} ({error})"
        ) from error
    if problems := misfits(tensors, {f"model.{key}": value for key, value in expected.items()}):
        raise ValueError(
            f"{path} is damaged: its tensors are not those of a model of its sizes: "
            + "; ".join(problems[:8])
        )
