"""Freed memory stays with the process, where the C library can be told so."""

import os
import platform
import subprocess
import sys

import pytest

from pemirl_lab.runs import memory

# Ever larger blocks, one after the other: how many pages does the kernel clear for them?
FAULTS = """
import resource, sys
from pemirl_lab.runs.memory import keep_freed_memory
import torch
print(keep_freed_memory() if sys.argv[1] == "keep" else None)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for megabytes in range(1, 21):
    torch.ones(megabytes * 2**18)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""
GLIBC = pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other C libraries differ")


def faults(how: str, **variables: str) -> tuple[str, int]:
    """What the function said, and how many pages were cleared."""
    env = {k: v for k, v in os.environ.items() if not k.startswith("MALLOC_")} | variables
    command = [sys.executable, "-c", FAULTS, how]
    said, count = subprocess.check_output(command, env=env, text=True).split()
    return said, int(count)


@GLIBC
def test_a_freed_block_is_used_again_and_not_cleared_by_the_kernel():
    told, kept = faults("keep")
    _, untold = faults("leave")
    assert told == "True"
    assert kept * 2 < untold  # the largest block's, and those of all of them


@GLIBC
def test_who_has_set_the_allocator_keeps_that():
    told, _ = faults("keep", MALLOC_TRIM_THRESHOLD_="1000000")
    assert told == "False"


def test_elsewhere_nothing_happens(monkeypatch):
    monkeypatch.setattr(memory.ctypes, "CDLL", lambda name: object())
    for name in ("MALLOC_TRIM_THRESHOLD_", "MALLOC_MMAP_THRESHOLD_"):
        monkeypatch.delenv(name, raising=False)
    assert memory.keep_freed_memory() is False
