"""A probe of contexts, on relations that are known."""

import pytest
import torch

from pemirl_trl.evaluation import linear_probe


def test_an_affine_function_of_the_task_is_read_perfectly():
    torch.manual_seed(0)
    task, unseen = torch.randn(50, 2), torch.randn(20, 2)
    turn, shift = torch.tensor([[2.0, 1.0, 0.0], [0.0, -1.0, 3.0]]), torch.tensor([1.0, 0.0, -2.0])
    measures = linear_probe(task @ turn + shift, task, unseen @ turn + shift, unseen)
    assert measures == {"r2": pytest.approx(1.0, abs=1e-4)}


def test_noise_explains_nothing():
    torch.manual_seed(0)
    measures = linear_probe(*(torch.randn(2000, 2) for _ in range(4)))
    assert measures["r2"] == pytest.approx(0.0, abs=0.02)


def test_half_of_the_variance():
    torch.manual_seed(0)
    task, unseen = torch.randn(4000, 1), torch.randn(4000, 1)
    noisy = [t + torch.randn_like(t) for t in (task, unseen)]  # signal and noise alike
    assert linear_probe(noisy[0], task, noisy[1], unseen)["r2"] == pytest.approx(0.5, abs=0.03)


def test_directions_have_an_accuracy():
    task = torch.tensor([[1.0], [-1.0]]).repeat(10, 1)
    unseen = torch.tensor([[1.0], [1.0], [-1.0], [-1.0]])
    context = torch.tensor([[0.9], [-0.2], [-1.1], [-0.8]])  # the second one misleads
    measures = linear_probe(task, task, context, unseen)
    assert measures["accuracy"] == 0.75
    assert set(measures) == {"r2", "accuracy"}


def test_tasks_that_are_all_alike_are_refused():
    same = torch.zeros(4, 1)
    with pytest.raises(ValueError, match="all at the mean"):
        linear_probe(torch.randn(4, 1), same, torch.randn(4, 1), same)
