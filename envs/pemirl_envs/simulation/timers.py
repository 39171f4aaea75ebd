"""MuJoCo's internal timers, off while a batch steps.

The Python package installs a clock as ``mjcb_time``. Every step of every simulation reads it dozens
of times, to fill ``mjData.timer``; on a small model that is a good part of the time. The package
can replace the clock but not remove it. The C library can: with a null pointer it reads none.
"""

from __future__ import annotations

import contextlib
import ctypes
import functools
import pathlib
from collections.abc import Iterator

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


@contextlib.contextmanager
def timers_off() -> Iterator[None]:
    """Within it simulations step untimed; states are the same to the last bit."""
    callback = _callback()
    if callback is None:
        yield
        return
    clock, callback.value = callback.value, None
    try:
        yield
    finally:
        callback.value = clock
