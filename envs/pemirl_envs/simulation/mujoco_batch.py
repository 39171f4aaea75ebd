"""Simulations on MuJoCo's native batch: N states stepped on a pool of threads."""

from __future__ import annotations

import ctypes
import os
import weakref
from collections.abc import Sequence
from contextlib import AbstractContextManager

import mujoco
import mujoco.batch
import numpy as np
import torch
from torch import Tensor

from pemirl_envs.simulation.base import State
from pemirl_envs.simulation.timers import timers_off

STATE_FIELDS = ("time", "qpos", "qvel", "act", "ctrl", "mocap_pos", "mocap_quat", "qfrc_applied")
_WARNINGS = [w.name.removeprefix("mjWARN_") for w in mujoco.mjtWarning.__members__.values()]


def available_cpus() -> int:
    """The number of CPUs that this process may run on (its affinity mask, where there is one)."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class MujocoBatch:
    """``N`` simulations of one MuJoCo model (:class:`~pemirl_envs.simulation.Simulation`).

    Results are bit-identical at any number of threads.

    Args:
        model: the model, copied.
        num_sims: the number of simulations, N.
        num_threads: threads that step them, the caller's included. Default: one for each CPU in
            the affinity mask of the process. Never more than ``num_sims``.
        stage: the forward stage (``mujoco.mjtStage``) to compute whenever the state has changed,
            so that the derived fields that it fills can be read. Costs time; the default computes
            none, which leaves the state fields alone readable.

    Raises:
        ValueError: ``num_sims`` or ``num_threads`` is not positive; or, from whatever computes, a
            callback of MuJoCo (``mjcb_control``, ...) is a Python function, which MuJoCo names.
        RuntimeError: from whatever computes: the process was forked since the batch was made, and
            the batch had more than one thread.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        num_sims: int,
        num_threads: int | None = None,
        stage: mujoco.mjtStage = mujoco.mjtStage.mjSTAGE_NONE,
    ) -> None:
        num_threads = available_cpus() if num_threads is None else num_threads
        if num_sims < 1 or num_threads < 1:
            raise ValueError(
                f"expected num_sims >= 1 and num_threads >= 1, got {num_sims} and {num_threads}"
            )
        self._batch = mujoco.batch.Batch(model, num_sims, min(num_threads, num_sims))
        if self._batch.nthread > 1:
            _with_threads.add(self)
        self._lost_threads = False
        self._before = np.empty_like(self._batch.state)  # reused: a new one costs its page faults
        self._stage = int(stage)
        self._computes_derived = stage != mujoco.mjtStage.mjSTAGE_NONE
        self._state_fields: dict[str, Tensor] = {}
        self._derived_fields: dict[str, np.ndarray] = {}

    @property
    def num_sims(self) -> int:
        """The number of simulations, N."""
        return int(self._batch.nsim)

    @property
    def num_threads(self) -> int:
        """The number of threads that step the simulations, the caller's included."""
        return int(self._batch.nthread)

    @property
    def state(self) -> Tensor:
        """A copy of every simulation's ``mjSTATE_INTEGRATION`` row, float64 ``[N, n_state]``."""
        return torch.from_numpy(self._batch.state.copy())

    def field(self, name: str) -> Tensor:
        """The current values of an ``MjData`` field, ``[N, ...]``.

        A state field is a live view, to read and not to keep. A derived field is a copy.

        Raises:
            ValueError: MuJoCo does not bind the field, or it is a derived one (``xpos``,
                ``sensordata``, ...) and this batch computes no stage.
        """
        if name in self._state_fields:
            return self._state_fields[name]
        if name in STATE_FIELDS:
            self._state_fields[name] = torch.from_numpy(self._batch.bind(name))
            return self._state_fields[name]
        if not self._computes_derived:
            raise ValueError(
                f"the field {name!r} is derived from the state, and this batch computes no stage: "
                f"pass stage=mujoco.mjtStage.mjSTAGE_POS (or _VEL, _ACC), or read one of "
                f"{', '.join(STATE_FIELDS)}"
            )
        if name not in self._derived_fields:
            with self._computing():
                self._derived_fields[name] = self._batch.bind(name)
                self._batch.forward(stage=self._stage)  # it would be zero until the next call
        return torch.from_numpy(self._derived_fields[name].copy())

    def set_models(self, models: Sequence[mujoco.MjModel]) -> None:
        """Runs simulation i on ``models[i]`` from now on.

        Raises:
            ValueError: a model's sizes differ from those of the batch's, or there are not N.
        """
        self._batch.set_models(list(models))

    def write(self, state: State, mask: Tensor | None = None, *, refresh: bool = True) -> None:
        """Writes state fields of the simulations in ``mask`` (bool ``[N]``; ``None``: all).

        Without ``refresh``, derived fields keep their values until the next step.

        Raises:
            ValueError: a field is not a state field.
        """
        for name, values in state.items():
            if name not in STATE_FIELDS:
                raise ValueError(
                    f"cannot write the field {name!r}; expected one of {', '.join(STATE_FIELDS)}"
                )
            field = self.field(name)
            if mask is None:
                field.copy_(values)
            else:
                field[mask] = values[mask].to(field.dtype)
        if refresh and self._computes_derived and state.keys() - {"ctrl"}:
            with self._computing():
                self._batch.forward(_ids(mask), stage=self._stage)

    def step(self, n_sub_steps: int, mask: Tensor | None = None) -> dict[int, str]:
        """Advances the simulations in ``mask``; see :class:`~pemirl_envs.simulation.Simulation`.

        MuJoCo resets a simulation whose state turns bad (non-finite or huge) to the model's
        defaults and goes on; its warning counters alone tell. Such a simulation counts as failed.
        """
        np.copyto(self._before, self._batch.state)
        failures: dict[int, str] = {}
        try:
            with self._computing():
                self._batch.step(_ids(mask), n_sub_steps, self._stage)
        except mujoco.batch.SimulationError as error:
            failures = {int(i): self._batch.error(int(i)) for i in error.ids}
        counts = self._batch.warning[..., 1]
        if counts.any():
            for i in np.flatnonzero(counts.any(1)):
                names = ", ".join(_WARNINGS[w] for w in np.flatnonzero(counts[i]))
                failures[int(i)] = f"MuJoCo warned of {names}"
        if failures:
            self._restore(sorted(failures))
        return failures

    def _restore(self, ids: list[int]) -> None:
        self._batch.state[ids] = self._before[ids]
        self._batch.warning[ids] = 0
        if self._computes_derived:
            with self._computing():
                self._batch.forward(np.asarray(ids, np.int32), stage=self._stage)

    def reset(self, mask: Tensor | None = None) -> None:
        """Puts the simulations in ``mask`` (bool ``[N]``; ``None``: all) into the default state."""
        with self._computing():
            self._batch.reset(_ids(mask), stage=self._stage)

    def _computing(self) -> AbstractContextManager[None]:
        """Around whatever computes: without MuJoCo's timers, and not where it would wait forever.

        Raises:
            RuntimeError: the process was forked since the batch was made.
        """
        if self._lost_threads:
            raise RuntimeError(
                f"these {self.num_sims} simulations step on {self.num_threads} threads, which "
                "stayed in the process that made them; this is a fork of it. Make the environment "
                "inside the worker: give the worker a factory, such as "
                "functools.partial(pemirl_envs.make, name, num_envs), instead of the environment"
            )
        return timers_off()

    def _after_fork(self) -> None:
        self._lost_threads = True
        # Freeing the batch would wait for its threads, which the child does not have.
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(self._batch))


_with_threads: weakref.WeakSet[MujocoBatch] = weakref.WeakSet()


def _after_fork_in_child() -> None:
    for batch in _with_threads:
        batch._after_fork()


if hasattr(os, "register_at_fork"):  # not on Windows, which does not fork
    os.register_at_fork(after_in_child=_after_fork_in_child)


def _ids(mask: Tensor | None) -> np.ndarray | None:
    return None if mask is None else mask.numpy()
