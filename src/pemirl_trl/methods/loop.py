"""The loop around every method: iterate, check, report, checkpoint, resume."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Protocol

import torch
from torch import Tensor, nn

from pemirl_trl.checkpoint import TrainingCheckpoint

Metrics = dict[str, float]


class Method(Protocol):
    """What the loop asks of a method."""

    iterations: int

    @property
    def env_steps(self) -> int:
        """Environment steps so far; 0 for a method without an environment."""

    def iteration(self) -> Metrics:
        """Do one iteration and say what happened."""

    def components(self) -> Mapping[str, Any]:
        """What a checkpoint holds: objects with ``state_dict`` and ``load_state_dict``."""


class TrainingDiverged(RuntimeError):  # noqa: N818 (it says what happened)
    """A quantity stopped being finite, or exploded.

    Attributes:
        quantity: its name.
        value: what it became.
        iteration: the iteration (from 1) that produced it.
    """

    def __init__(self, quantity: str, value: float, iteration: int, last_good: str) -> None:
        super().__init__(
            f"training diverged: {quantity} became {value} in iteration {iteration}. {last_good}"
        )
        self.quantity, self.value, self.iteration = quantity, value, iteration


def train(
    method: Method,
    *,
    checkpoint: TrainingCheckpoint | None = None,
    checkpoint_every: int = 25,
    on_iteration: Callable[[int, Metrics], None] | None = None,
    limit: float = 1e9,
) -> Metrics:
    """Run a method to its end, resuming from the newest checkpoint if there is one.

    On the CPU a resumed run repeats an uninterrupted one bit for bit, provided that the number of
    threads is the same (sums of floats depend on how torch splits them) and that the environment
    can tell its random state.

    Args:
        method: the method; its state is loaded in place.
        checkpoint: where to save and resume; None does neither.
        checkpoint_every: iterations between checkpoints, at least 1; the last iteration always has
            one.
        on_iteration: called with the iteration (from 1) and its metrics.
        limit: a metric or a weight of larger magnitude counts as exploded.

    Returns:
        The last iteration's metrics; empty if there was nothing left to do.

    Raises:
        TrainingDiverged: a metric or a weight is not finite or exceeds the limit, or any floating
            state that was about to be saved is not finite, an optimiser's included. Nothing is
            saved then: the newest checkpoint is the last good one.
        ValueError: ``checkpoint_every`` is less than 1, or the checkpoint is of a longer run.
    """
    if checkpoint_every < 1:
        raise ValueError(f"checkpoint_every is {checkpoint_every}; expected at least 1 iteration")
    done = 0
    if checkpoint is not None:
        done = checkpoint.load_latest(method.components()) or 0
    if done > method.iterations:
        raise ValueError(
            f"the checkpoint is of iteration {done}, the method has {method.iterations} "
            "iterations: give it at least as many, or another checkpoint directory"
        )
    saved = done
    metrics: Metrics = {}
    for iteration in range(done + 1, method.iterations + 1):
        metrics = method.iteration()
        last_good = "No checkpoint was saved."
        if checkpoint is not None and saved:
            last_good = f"The last good checkpoint is that of iteration {saved}."
        _check(metrics, method, iteration, limit, last_good)
        if on_iteration is not None:
            on_iteration(iteration, metrics)
        due = iteration % checkpoint_every == 0 or iteration == method.iterations
        if checkpoint is not None and due:
            _check_state(method, iteration, last_good)
            checkpoint.save(method.components(), iteration)
            saved = iteration
    return metrics


def iteration_count(steps: int, steps_per_iteration: int) -> int:
    """How many iterations make up ``steps``.

    Raises:
        ValueError: they are not a positive multiple of ``steps_per_iteration``.
    """
    if steps_per_iteration < 1 or steps < 1 or steps % steps_per_iteration:
        raise ValueError(
            f"steps is {steps}; expected a positive multiple of steps_per_iteration, "
            f"which is {steps_per_iteration}"
        )
    return steps // steps_per_iteration


def _check(metrics: Metrics, method: Method, iteration: int, limit: float, last_good: str) -> None:
    for name, value in metrics.items():
        if not math.isfinite(value) or abs(value) > limit:
            raise TrainingDiverged(name, value, iteration, last_good)
    for key, component in method.components().items():
        if isinstance(component, nn.Module):
            for name, weight in component.named_parameters():
                largest = float(weight.detach().abs().max()) if weight.numel() else 0.0
                if not largest <= limit:  # NaN if any weight is
                    raise TrainingDiverged(f"{key}.{name}", largest, iteration, last_good)


def _check_state(method: Method, iteration: int, last_good: str) -> None:
    """Raise TrainingDiverged if a floating tensor of what is about to be saved is not finite."""
    for key, component in method.components().items():
        for name, tensor in _tensors(component.state_dict(), key):
            if tensor.is_floating_point() and not bool(torch.isfinite(tensor).all()):
                worst = float(tensor[~torch.isfinite(tensor)][0])
                raise TrainingDiverged(name, worst, iteration, last_good)


def _tensors(state: Any, name: str) -> Iterator[tuple[str, Tensor]]:
    """Every tensor in nested state, with its path."""
    match state:
        case Tensor():
            yield name, state
        case Mapping():
            for key, value in state.items():
                yield from _tensors(value, f"{name}.{key}")
        case list() | tuple():
            for index, value in enumerate(state):
                yield from _tensors(value, f"{name}.{index}")
