"""The tasks of every domain: one module beside one model file, and one line here."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping

from pemirl_envs.tasks import ant, point_maze, sawyer_pusher, sweeper
from pemirl_envs.tasks.base import Layout, Parameters, Task
from pemirl_envs.tasks.bodies import SeveralBodies
from pemirl_envs.tasks.quantities import Component, Controller, Outcome

Variants = Mapping[str, Callable[[], Task]]
"""The tasks of a domain by variant, each as a function that makes one."""

_NAME = re.compile(r"[a-z][a-z0-9]*(_[a-z0-9]+)*")

DOMAINS: dict[str, Variants] = {}
"""The variants of every domain by name; :func:`register` adds to it."""

TASKS: dict[str, Callable[[], Task]] = {}
"""Every task by name, ``"domain/variant"``; :func:`register` adds to it."""


def register(domain: str, variants: Variants) -> None:
    """Makes the variants of a domain known as ``"domain/variant"``.

    Raises:
        ValueError: the domain is taken or has no variants, or a name is not of the form
            ``lower_case``.
        TypeError: a variant is not a function (or class) that makes a task.
    """
    if domain in DOMAINS:
        raise ValueError(f"the domain {domain!r} is taken; taken are {', '.join(DOMAINS)}")
    if not variants:
        raise ValueError(f"the domain {domain!r} has no variants; expected one or more by name")
    for name in (domain, *variants):
        if not _NAME.fullmatch(name):
            raise ValueError(
                f"malformed name {name!r}; expected lower-case letters, digits and single "
                "underscores between them, such as 'point_maze'"
            )
    for name, build in variants.items():
        if not callable(build):
            raise TypeError(
                f"the variant {domain}/{name} is {build!r}; expected a function without arguments "
                "that makes a Task, such as its class"
            )
    DOMAINS[domain] = dict(variants)
    TASKS.update({f"{domain}/{variant}": build for variant, build in variants.items()})


def get_task(name: str) -> Task:
    """The task of a name such as ``"point_maze/left"``.

    Raises:
        ValueError: there is no such task.
    """
    if name not in TASKS:
        raise ValueError(
            f"unknown task {name!r}; expected one of {', '.join(TASKS)}, or one of a domain that "
            "pemirl_envs.register_domain has made known in this process"
        )
    return TASKS[name]()


register("point_maze", point_maze.VARIANTS)
register("ant", ant.VARIANTS)
register("sawyer_pusher", sawyer_pusher.VARIANTS)
register("sweeper", sweeper.VARIANTS)

__all__ = [
    "DOMAINS",
    "TASKS",
    "Component",
    "Controller",
    "Layout",
    "Outcome",
    "Parameters",
    "SeveralBodies",
    "Task",
    "Variants",
    "get_task",
    "register",
]
