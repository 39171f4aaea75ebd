"""Families of bodies: who demonstrates in each, and the body in which a policy is trained anew."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from mirror import Mirror, MirroredPolicy, X, Y
from tensordict import TensorDict
from torch import Tensor

from pemirl_envs import Controller, Parameters, SeveralBodies, Task, get_task
from pemirl_envs.tasks.ant import Ant
from pemirl_envs.tasks.sawyer_pusher import SawyerPusher
from pemirl_envs.tasks.sweeper import Sweeper
from pemirl_lab.measuring.experts import load_expert
from pemirl_trl import ContextPolicy


@dataclass(frozen=True)
class Body:
    """A body, and a demonstrator: (observation ``[N, S]``, parameters) -> action, its noise in it.

    The demonstrator is made when it is needed, since an expert is read from a file.
    """

    task: Task
    demonstrator: Callable[[], Controller]


@dataclass(frozen=True)
class Family:
    """What an experiment with several bodies needs to know of a domain.

    Attributes:
        task: the domain; its experiment ``experiment=TASK`` gives every setting.
        bodies: in the order in which they join; the first is that of the new demonstrations.
        several: makes one task of so many of them.
        changed: the dynamics in which a policy is trained anew; none of the bodies.
        known: the best that is known there.
        demonstrations: of each task, shared evenly by the bodies.
        split: whose tasks are demonstrated for training.
    """

    task: str
    bodies: tuple[Body, ...]
    several: Callable[[Sequence[Task]], SeveralBodies]
    changed: str
    known: Callable[[], Controller]
    demonstrations: int
    split: str


def component_names(task: Task) -> list[str]:
    """One name for each number of an observation."""
    return [
        f"{part.name}[{i}]" if part.size > 1 else part.name
        for part in task.observation_components
        for i in range(part.size)
    ]


# --- Sawyer Pusher: walls in the way ------------------------------------------------------------

NOISE = 0.2  # cm, of the hand's steps: as a person's would have some


class SeveralWalls(SeveralBodies, SawyerPusher):
    """Sawyer Pusher, the wall in its way another one from episode to episode."""

    def __init__(self, bodies: Sequence[Task]) -> None:
        SawyerPusher.__init__(self)
        self.use_bodies(bodies)


def _wall(wall: float, *, mirrored: bool = False) -> Body:
    task = SawyerPusher(wall, mirrored=mirrored)
    return Body(task, lambda: _noisy(_scripted(task)))


def _scripted(task: Task) -> Controller:
    controller = task.scripted_controller()
    if controller is None:
        raise ValueError(f"{type(task).__name__} has no controller by hand")
    return controller


def _noisy(controller: Controller) -> Controller:
    def act(observation: Tensor, parameters: Parameters) -> Tensor:
        action = controller(observation, parameters)
        return action + NOISE * torch.randn(action.shape)

    return act


SAWYER = Family(
    task="sawyer_pusher",
    bodies=(
        # A stub at the edge, which neither hand nor mug can reach: models have to be of one size.
        Body(SawyerPusher(0.44), lambda: _noisy(_scripted(SawyerPusher()))),
        _wall(-0.15, mirrored=True),
        _wall(0.05),
        _wall(-0.25, mirrored=True),
    ),
    several=SeveralWalls,
    changed="sawyer_pusher/shift",
    known=lambda: _scripted(get_task("sawyer_pusher/shift")),
    demonstrations=4,
    split="train_100",
)


# --- Ant: other legs disabled -------------------------------------------------------------------


class SeveralAnts(SeveralBodies, Ant):
    """Ant, its disabled legs other ones from episode to episode."""

    def __init__(self, bodies: Sequence[Task]) -> None:
        Ant.__init__(self)
        self.use_bodies(bodies)


def _ant(expert: str, legs: tuple[int, ...] = (), mirrors: tuple[Mirror, ...] = ()) -> Body:
    """An ant and an expert of it; with mirrors, of its mirror image."""
    for mirror in mirrors:
        legs = mirror.disabled(legs)
    return Body(
        Ant(disabled=legs),
        lambda: _acting(MirroredPolicy(_expert(f"ant_{expert}"), mirrors), "direction"),
    )


def _expert(name: str) -> ContextPolicy:
    return load_expert(f"data/{name}_expert.safetensors")


def _acting(policy: Callable[[TensorDict], TensorDict], key: str) -> Controller:
    """A policy that reads one parameter of its task, as a controller."""

    def act(observation: Tensor, parameters: Parameters) -> Tensor:
        task = {key: parameters[key]}
        batch = observation.shape[:-1]
        return policy(TensorDict({"observation": observation, "task": task}, batch))["action"]

    return act


ANT = Family(
    task="ant",
    bodies=(
        _ant("normal"),
        _ant("disabled_left_first", (2, 3)),
        _ant("disabled_diagonal", (1, 3)),
        _ant("disabled_one", (2,)),
        _ant("disabled_left_first", (2, 3), (X,)),
        _ant("disabled_diagonal", (1, 3), (X,)),
        _ant("disabled_one", (2,), (X,)),
        _ant("disabled_one", (2,), (Y,)),
    ),
    several=SeveralAnts,
    changed="ant/disabled",
    known=lambda: _acting(_expert("ant_disabled"), "direction"),
    demonstrations=64,
    split="train",
)


# --- Sweeper: other blades, other joints --------------------------------------------------------


class SeveralSweepers(SeveralBodies, Sweeper):
    """Sweeper, its blade and its joints' damping other ones from episode to episode."""

    def __init__(self, bodies: Sequence[Task]) -> None:
        Sweeper.__init__(self)
        self.use_bodies(bodies)


def _sweeper(variant: str) -> Body:
    return Body(
        get_task(f"sweeper/{variant}"), lambda: _acting(_expert(f"sweeper_{variant}"), "goal")
    )


SWEEPER = Family(
    task="sweeper",
    bodies=tuple(_sweeper(variant) for variant in ("normal", "wide", "narrow", "limp")),
    several=SeveralSweepers,
    changed="sweeper/shift",
    known=lambda: _acting(_expert("sweeper_shift"), "goal"),
    demonstrations=4,
    split="train_100",
)

FAMILIES = {"sawyer_pusher": SAWYER, "ant": ANT, "sweeper": SWEEPER}
