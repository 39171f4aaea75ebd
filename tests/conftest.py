"""Shared state of the tests: one thread, known seeds, nothing left behind."""

import os
import random
from collections.abc import Iterator

import numpy as np
import pytest
import torch

# TorchRL reads these when it is imported, hence before any test module. Its warnings on batch
# sizes and target networks advise training runs; its log lines would drown pytest's.
os.environ.setdefault("RL_WARNINGS", "0")
os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")

# The tensors are small, and the order of a reduction depends on the number of threads.
torch.set_num_threads(1)


@pytest.fixture(autouse=True)
def _isolated() -> Iterator[None]:
    """Seed every global generator; restore them and the default dtype afterwards."""
    python, numpy, dtype = random.getstate(), np.random.get_state(), torch.get_default_dtype()
    with torch.random.fork_rng(devices=[]):
        random.seed(0)
        np.random.seed(0)
        torch.manual_seed(0)
        yield
    torch.set_default_dtype(dtype)
    np.random.set_state(numpy)
    random.setstate(python)


@pytest.fixture
def float64(_isolated: None) -> None:
    """Make float64 the default dtype: rounding no longer hides the difference to an oracle."""
    torch.set_default_dtype(torch.float64)
