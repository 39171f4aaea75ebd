"""What the C library does with memory that tensors have left."""

from __future__ import annotations

import ctypes
import os

# Parameters of mallopt, of glibc's malloc.h.
_MALLOC_TRIM_THRESHOLD, _MALLOC_MMAP_THRESHOLD = -1, -3
_LARGEST = 2**31 - 1  # bytes; mallopt takes a C int


def keep_freed_memory() -> bool:
    """Let this process keep what it frees, and say whether the C library knows how.

    glibc hands large freed blocks back to the kernel, which clears them anew for the next batch:
    of an iteration on Point-Maze 2 to 5 %. Memory at its peak stays the same, and so does every
    result. Other C libraries have their own ways, and whoever has set ``MALLOC_TRIM_THRESHOLD_`` or
    ``MALLOC_MMAP_THRESHOLD_`` has decided: then nothing changes.
    """
    if {"MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_"} & set(os.environ):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # not glibc; on Windows, CDLL takes no None
        return False
    trims_late = mallopt(_MALLOC_TRIM_THRESHOLD, _LARGEST) == 1
    maps_late = mallopt(_MALLOC_MMAP_THRESHOLD, _LARGEST) == 1
    return trims_late and maps_late
