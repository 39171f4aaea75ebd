"""A geometric path, by hand."""

import pytest
import torch

from pemirl_trl.methods.schedule import AnnealedScale, log_linear


@pytest.mark.parametrize(
    ("progress", "expected"),
    [(0.0, 8.0), (0.2, 8.0), (0.3, 4.0), (0.4, 2.0), (0.6, 0.5), (0.8, 0.5), (1.0, 0.5)],
)
def test_it_moves_between_begin_and_finish(progress, expected):
    # A factor of 16 over 0.2 .. 0.6: each 0.1 divides by 2.
    assert log_linear(8.0, 0.5, progress, begin=0.2, finish=0.6) == pytest.approx(expected)


def test_it_takes_the_whole_training_unless_told():
    assert [log_linear(0.01, 1.0, p) for p in (0, 0.5, 1)] == pytest.approx([0.01, 0.1, 1.0])


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((0.0, 1.0, 0.5, 0.0, 1.0), "got start 0.0"),
        ((1.0, -1.0, 0.5, 0.0, 1.0), "end -1.0"),
        ((1.0, 2.0, 0.5, 1.0, 1.0), "begin 1.0 and finish 1.0"),
    ],
)
def test_what_has_no_path_is_refused(values, message):
    start, end, progress, begin, finish = values
    with pytest.raises(ValueError, match=f"{message}.*expected positive start and end"):
        log_linear(start, end, progress, begin=begin, finish=finish)


def test_an_annealed_scale_is_forced_and_another_is_left_alone():
    forced = torch.nn.Parameter(torch.zeros(3))  # a deviation of 1
    scale = AnnealedScale(forced, 0.25, begin=0.5, finish=1.0)
    assert not forced.requires_grad
    seen = []
    for progress in (0.0, 0.5, 0.75, 1.0):
        scale.move(progress)
        seen.append(float(forced.exp().mean()))
    assert seen == pytest.approx([1.0, 1.0, 0.5, 0.25])
    learned = torch.nn.Parameter(torch.zeros(3))
    AnnealedScale(learned, None, begin=0.0, finish=1.0).move(0.5)
    assert learned.requires_grad
    assert torch.equal(learned, torch.zeros(3))
