"""float32 keeps what a feature varies by, or says what it would lose."""

import numpy as np
import pytest
import torch

from pemirl_trl.data.conversion import narrowed, plain_tensor, wide_tensor

M, T = 4, 101
TIME = torch.arange(T, dtype=torch.float64)


def episodes(feature):
    """[M, T, 2] whose feature 1 is ``feature`` [T] or [M, T]."""
    values = torch.zeros(M, T, 2, dtype=torch.float64)
    values[..., 1] = torch.as_tensor(feature)
    return values


LOST = {
    "a map projection": 4.2e6 + 0.05 * TIME,
    "seconds since 1970": 1.7e9 + 0.01 * TIME,
    "large integers": 2.0**24 + TIME,
    "steps, though the range is wide": 1e6 * torch.arange(M)[:, None] + 3e5 + 0.01 * TIME,
    "values below float32's range": 1e-50 * TIME,
    "one episode of many": torch.stack([TIME * 0.05 + offset for offset in (0, 0, 4.2e6, 0)]),
}
KEPT = {
    "small numbers": 0.05 * TIME,
    "a moderate offset": 1e4 + 0.05 * TIME,
    "noise at rest": 0.42 + 1e-8 * torch.randn(M, T, dtype=torch.float64),
    "a constant": torch.full((T,), 1.7e9),
    "exact integers": 1e6 + TIME,
    "an episode at rest": torch.stack([torch.sin(TIME) * s + 9.0 for s in (1, 1, 1e-9, 1)]),
}


@pytest.mark.parametrize("feature", LOST.values(), ids=LOST.keys())
def test_a_relevant_loss_is_refused(feature):
    with pytest.raises(ValueError, match=r"x feature 1 loses .* episode \d, its 101 distinct"):
        narrowed("x", episodes(feature))


@pytest.mark.parametrize("feature", KEPT.values(), ids=KEPT.keys())
def test_what_float32_keeps_is_rounded_and_no_more(feature):
    assert torch.equal(narrowed("x", episodes(feature)), episodes(feature).float())


def test_the_loss_and_the_cure_are_named():
    with pytest.raises(ValueError, match=r"101 distinct values become 11\. Subtract .* 4200002\.5"):
        narrowed("x", episodes(LOST["a map projection"]))
    assert narrowed("x", episodes(LOST["a map projection"]).float()).dtype == torch.float32


def test_one_step_and_no_feature_are_no_matter():
    for shape in ((2, 1, 3), (2, 5, 0)):
        given = torch.full(shape, 1 / 3, dtype=torch.float64)
        assert torch.equal(narrowed("x", given), given.float())


@pytest.mark.parametrize(
    ("dtype", "expected"),
    [
        (np.float16, torch.float32),
        (np.float32, torch.float32),
        (">f4", torch.float32),
        (np.float64, torch.float64),
        (np.longdouble, torch.float64),
        (np.int16, torch.float32),
        (np.int32, torch.float64),
        (np.uint64, torch.float64),
        (bool, torch.float32),
    ],
)
def test_every_real_dtype_is_taken_without_loss(dtype, expected):
    array = np.array([[0, 1], [1, 0]], dtype=dtype)
    wide = wide_tensor(array, "x")
    assert wide.dtype == expected
    assert wide.tolist() == array.tolist()


def test_a_plain_tensor_keeps_its_dtype_and_has_memory_of_its_own():
    array = np.arange(3)
    tensor = plain_tensor(array, "x")
    array[0] = 7
    assert tensor.dtype == torch.int64
    assert tensor.tolist() == [0, 1, 2]
