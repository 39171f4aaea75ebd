"""Settings for a task that nobody has tuned: what its demonstrations say, in one place.

A preset says which method; sizes of batches and budgets follow from the horizon, the number of
demonstrations and the size of their actions. Every one can be given instead.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Literal

from pemirl_trl.configuration import typed
from pemirl_trl.data import DemonstrationDataset
from pemirl_trl.data.lengths import steps_after
from pemirl_trl.methods.adaptation import AdaptationConfig
from pemirl_trl.methods.meta_training import METHODS, TRAINING, MethodConfig
from pemirl_trl.methods.requirements import check_acted
from pemirl_trl.modules import PEMIRLModel
from pemirl_trl.modules.model import ActionKind

PRESETS: Mapping[str, str] = {
    "paper": "pemirl",
    "robust": "pemirl_robust",
    "contrastive": "pemirl_contrastive",
}
"""Names of ways of meta-training, and their entries in :data:`METHODS`."""

META_TRAINING_STEPS = 2_000_000
"""Environment steps of meta-training, about."""
ADAPTATION_STEPS = 1_300_000
"""Environment steps of adaptation, about, without the short tries that choose its start."""
STEPS_PER_ITERATION = 40_000
LEAST_ITERATIONS = 50
"""A trust-region method needs its steps, however long the episodes are."""

KL_SHARE = 0.1
"""Of the evidence bound's own weight of KL(q || N(0, I)), which is 1 / T.

Where a demonstration comes to rest, its states show the task, and imitation needs m for the way
alone: at the whole weight m stays vague (docs/faq.md has numbers).
"""

PART_SHARE = 0.5
"""Of demonstrations that q sees one part of, while the policy imitates the other: m is the task and
not the way (docs/proofs.md has numbers). Not for ``"paper"``."""
META_IL_LR = 2e-3
"""Where Adam's rate starts; it falls to 0 along half a cosine."""

UNIFORM_SHARE, FINAL_UNIFORM_SHARE = 0.3, 0.03
"""Of discrete actions, the share that is drawn uniformly while r takes shape, and at the end."""
ADAPTATION_SHARES = (0.5, 0.02)
"""The same at the start and at the end of adaptation."""

Exploration = Literal["wide", "narrow"]
"""How adaptation looks for better actions.

``"wide"``: the deviation falls from three times the size of actions to a tenth of it, undiscounted,
with imitation of the best trajectories: for a point that has to find another way. ``"narrow"``: it
starts at half of their size and is learned, discounted: a gait does not survive the other.
"""
Values = Mapping[str, Any]


def meta_training_config(
    demonstrations: DemonstrationDataset, preset: str = "robust", overrides: Values | None = None
) -> MethodConfig:
    """The configuration of meta-training for demonstrations.

    Args:
        demonstrations: of the training tasks.
        preset: one of :data:`PRESETS`.
        overrides: fields of :class:`MethodConfig`; nested ones as dictionaries of what differs, or
            as whole configurations.

    Raises:
        ValueError: an unknown preset, or a wrong name or value of a setting.
    """
    if preset not in PRESETS:
        raise ValueError(f"unknown preset {preset!r}; choose one of {[*PRESETS]}")
    base = METHODS[PRESETS[preset]]
    found = found_for_meta_training(demonstrations, preset, overrides)
    values = merged(dataclasses.asdict(base), found, overrides or {})
    training = typed(TRAINING[base.algorithm], values.pop("training"), at="training")
    return typed(MethodConfig, {**values, "training": training})


def adaptation_config(
    model: PEMIRLModel,
    demonstrations: DemonstrationDataset,
    overrides: Values | None = None,
    exploration: Exploration = "wide",
) -> AdaptationConfig:
    """The configuration of adaptation to the reward of each of these demonstrations.

    Args:
        model: knows the size of the actions, by the deviation that its policy began with; those of
            one demonstration may all be small.
        demonstrations: one of each new task.
        overrides: fields of :class:`AdaptationConfig`, as in :func:`meta_training_config`.
        exploration: wide or narrow; of discrete actions always wide.

    Raises:
        ValueError: a wrong name or value of a setting.
    """
    found = found_for_adaptation(model, demonstrations, overrides, exploration)
    values = merged(dataclasses.asdict(AdaptationConfig()), found, overrides or {})
    return typed(AdaptationConfig, values)


def found_for_meta_training(
    demonstrations: DemonstrationDataset, preset: str, overrides: Values | None = None
) -> dict[str, Any]:
    """What the demonstrations say about meta-training, as a nested dictionary of settings.

    What is given counts where other values follow from it, such as iterations from rollouts.

    Raises:
        ValueError: the demonstrations have no actions, or none but 0.
    """
    check_acted(demonstrations)
    horizon, count = demonstrations.horizon, len(demonstrations)
    envs = _between(round(STEPS_PER_ITERATION / horizon), 100, 800)
    given = overrides or {}
    rollouts = _given(given, ("training", "rollouts_per_context"), _between(envs // 50, 4, 16))
    contexts = _given(given, ("contexts_per_batch",), min(50, count, max(1, envs // rollouts)))
    steps = contexts * rollouts * horizon
    kind = _kind(given, demonstrations)
    scale = action_size(demonstrations) if kind == "continuous" else UNIFORM_SHARE
    training: dict[str, Any] = {
        "iterations": max(LEAST_ITERATIONS, round(META_TRAINING_STEPS / steps)),
        "rollouts_per_context": rollouts,
        "batch": {"time_steps": _between(horizon // 10, 5, 50)},
    }
    if preset in ("robust", "contrastive"):
        final = 0.3 * scale if kind == "continuous" else FINAL_UNIFORM_SHARE
        training["policy"] = {"final_scale": final}
    if preset == "robust":
        # As Meta-IL made them, contexts stay what r was learned for. The level of log pi depends on
        # the units of actions and moves as the deviation shrinks: r need not chase it. What other
        # tasks' demonstrations do under this context says where this task's goal ends.
        training |= {"info_coeff": 0.0, "encoder_lr": 0.0}
        training["batch"] |= {"relative_log_prob": True, "mismatched_fraction": 0.25}
    meta_il: dict[str, Any] = {"kl_coeff": KL_SHARE / horizon, "batch_size": min(64, count)}
    if preset in ("robust", "contrastive"):
        meta_il |= {"part_share": PART_SHARE, "lr": META_IL_LR, "lr_schedule": "cosine"}
    model: dict[str, Any] = {"policy_scale": scale}
    if kind != "continuous":
        model["actions"] = kind
    if demonstrations.ended.any():
        model["absorbing"] = True
    if demonstrations.cut.any():
        model["encoder"] = "attention"  # the flat one reads all of T
    return {
        "model": model,
        **({} if kind == "continuous" else {"learn_policy_scale": False}),
        "meta_il": meta_il,
        "contexts_per_batch": contexts,
        "training": training,
    }


def found_for_adaptation(
    model: PEMIRLModel,
    demonstrations: DemonstrationDataset,
    overrides: Values | None = None,
    exploration: Exploration = "wide",
) -> dict[str, Any]:
    """What model and demonstrations say about adaptation; see :func:`found_for_meta_training`."""
    horizon, count = demonstrations.horizon, len(demonstrations)
    least = _between(round(18_000 / horizon), 60, 400)
    rollouts = _given(overrides or {}, ("rollouts",), count * max(4, round(least / count)))
    iterations = max(LEAST_ITERATIONS, round(ADAPTATION_STEPS / (rollouts * horizon)))
    scale = model.config.policy_scale
    optimization: dict[str, Any] = {"iterations": iterations}
    found = {"rollouts": rollouts, "optimization": optimization}
    if model.config.actions == "discrete":
        first, final = ADAPTATION_SHARES
        optimization |= {"final_scale": final, "imitate_best": 1.0}
        return {"policy_scale": first, **found}
    if exploration == "narrow":
        trpo = {"gamma": 0.99, "lmbda": 0.97, "max_kl": 0.06}
        optimization |= {"final_scale": None, "imitate_best": 0.0, "trpo": trpo}
        return {"policy_scale": 0.5 * scale, "learn_policy_scale": True, **found}
    # imitate_best is of a squared error in units of actions, beside standardised advantages.
    optimization |= {"final_scale": 0.1 * scale, "imitate_best": 1.0 / scale**2}
    return {"policy_scale": 3.0 * scale, **found}


def action_size(demonstrations: DemonstrationDataset) -> float:
    """Roughly the size of the demonstrated actions: what deviations are multiples of.

    The 0.95 quantile of their magnitude, in two digits: the library's deviations are those of
    actions that are bounded by 1.

    Raises:
        ValueError: all actions are 0.
    """
    action = demonstrations.action
    if demonstrations.length is not None:
        action = action[~steps_after(demonstrations.length, demonstrations.horizon)]
    size = float(action.abs().flatten()[:1_000_000].quantile(0.95))
    if size == 0.0:
        raise ValueError("the demonstrated actions are all 0; expected somebody to have acted")
    return float(f"{size:.2g}")


def merged(*layers: Values) -> dict[str, Any]:
    """Lay nested dictionaries over each other, later over earlier; dataclasses count as whole."""
    result: dict[str, Any] = {}
    for layer in layers:
        for name, value in layer.items():
            if dataclasses.is_dataclass(value) and not isinstance(value, type):
                result[name] = dataclasses.asdict(value)
            elif isinstance(value, Mapping) and isinstance(result.get(name), Mapping):
                result[name] = merged(result[name], value)
            else:
                result[name] = value
    return result


def table(found: Values, config: Any) -> str:
    """The settings that were found, with the values that are used, one a line."""
    rows = [(".".join(path), _read(config, path)) for path in _paths(found)]
    width = max(len(name) for name, _ in rows)
    return "\n".join(f"{name:<{width}}  {_shown(value)}" for name, value in rows)


def _shown(value: Any) -> str:
    return f"{value:g}" if type(value) in (int, float) else str(value)


def _paths(node: Values, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    for name, value in node.items():
        if isinstance(value, Mapping):
            yield from _paths(value, (*path, name))
        else:
            yield (*path, name)


def _read(config: Any, path: Sequence[str]) -> Any:
    for name in path:
        config = config[name] if isinstance(config, Mapping) else getattr(config, name)
    return config


def _given(overrides: Values, path: Sequence[str], otherwise: int) -> int:
    """The override at a path, where it is one that can be counted with."""
    node: Any = overrides
    for name in path:
        if dataclasses.is_dataclass(node):
            node = getattr(node, name, None)
        else:
            node = node.get(name) if isinstance(node, Mapping) else None
    return node if type(node) is int and node > 0 else otherwise


def _kind(overrides: Values, demonstrations: DemonstrationDataset) -> ActionKind:
    """The override of ``model.actions``, else what the demonstrations hold."""
    node: Any = overrides.get("model", {})
    given = node.get("actions") if isinstance(node, Mapping) else getattr(node, "actions", None)
    if given is None:
        return "discrete" if demonstrations.discrete else "continuous"
    return "discrete" if given == "discrete" else "continuous"


def _between(value: int, low: int, high: int) -> int:
    return max(low, min(high, value))
