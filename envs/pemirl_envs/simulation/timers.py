"""MuJoCo's internal timers, off while a batch steps.

The Python package installs a clock as ``mjcb_time``. Every step of every simulation reads it dozens
of times, to fill ``mjData.timer``; on a small model that is a good part of the time. The package
can replace the clock but not remove it. The C library can: with a null pointer it reads none.
A batch would refuse a clock that is a Python function, such as a profiler's; without one it runs.
"""

from __future__ import annotations

import ctypes
import functools
import pathlib
import threading
from contextlib import AbstractContextManager

import mujoco


@functools.cache
def _callback() -> ctypes.c_void_p | None:
    """The library's global ``mjcb_time``; None where the library or the symbol is not found."""
    folder = pathlib.Path(mujoco.__file__).parent
    for pattern in ("libmujoco*", "mujoco.dll"):
        for library in sorted(folder.glob(pattern)):
            try:
                return ctypes.c_void_p.in_dll(ctypes.CDLL(str(library)), "mjcb_time")
            except (OSError, ValueError):  # not a library, or no such symbol
                continue
    return None


class _TimersOff:
    """Takes the clock away for the first who enters, and puts it back after the last who leaves."""

    def __init__(self) -> None:
        self._lock = threading.Lock()  # batches may step in several Python threads at a time
        self._inside = 0
        self._clock: int | None = None

    def __enter__(self) -> None:
        callback = _callback()
        with self._lock:
            self._inside += 1
            if callback is not None and self._inside == 1:
                self._clock, callback.value = callback.value, None

    def __exit__(self, *error: object) -> None:
        callback = _callback()
        with self._lock:
            self._inside -= 1
            if callback is not None and self._inside == 0:
                callback.value = self._clock


_TIMERS_OFF = _TimersOff()


def timers_off() -> AbstractContextManager[None]:
    """Within it simulations step untimed; states are the same to the last bit."""
    return _TIMERS_OFF
