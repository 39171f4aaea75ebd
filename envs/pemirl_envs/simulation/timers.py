"""MuJoCo's internal timers, off while a batch steps.

The Python package installs a clock as ``mjcb_time``. Every step of every simulation reads it dozens
of times, to fill ``mjData.timer``; on a small model that is a good part of the time. The package
can replace the clock but not remove it. The C library can: with a null pointer it reads none.
A batch would refuse a clock that is a Python function, such as a profiler's; without one it runs.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import pathlib
import threading
from collections.abc import Iterator

import mujoco


class _Clock:
    """Takes the clock away while anyone needs it gone, and puts it back after the last."""

    def __init__(self) -> None:
        self._lock = threading.Lock()  # batches may step in several Python threads at a time
        self._users = 0
        self._kept: int | None = None

    def remove(self, callback: ctypes.c_void_p) -> None:
        with self._lock:
            self._users += 1
            if self._users == 1:  # for the others it is gone already
                self._kept, callback.value = callback.value, None

    def put_back(self, callback: ctypes.c_void_p) -> None:
        with self._lock:
            self._users -= 1
            if self._users == 0:
                callback.value = self._kept


_clock = _Clock()


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


@contextlib.contextmanager
def timers_off() -> Iterator[None]:
    """Within it simulations step untimed; states are the same to the last bit."""
    callback = _callback()
    if callback is None:
        yield
        return
    _clock.remove(callback)
    try:
        yield
    finally:
        _clock.put_back(callback)
