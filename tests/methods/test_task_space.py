"""What the task is about is found in pairs of demonstrations by two bodies, and only then."""

import pytest
import torch

from pemirl_trl import DemonstrationDataset, find_task_space

T, EACH = 20, 120
QUICK = {
    "meta_il": {"steps": 400, "batch_size": 32, "lr": 3e-3},
    "model": {"encoder_hidden": [32], "policy_hidden": [32]},
}


def walks(turns, seed):
    """Bodies that move to a hidden side, leaning: the lean tells the side, each its own way.

    Components: speed, lean, noise; the first two tell little at a time, so that the next action,
    the side itself, needs m.
    """
    generator = torch.Generator().manual_seed(seed)

    def noise(*shape):
        return torch.randn(EACH, *shape, generator=generator)

    side = torch.tensor([1.0, -1.0]).repeat(EACH // 2)
    speed = side[:, None] + noise(T + 1)
    lean = turns * side[:, None] + noise(T + 1)
    action = side[:, None] + 0.1 * noise(T)
    return DemonstrationDataset(torch.stack([speed, lean, noise(T + 1)], -1), action.unsqueeze(-1))


def test_what_both_bodies_do_is_found_and_a_habit_is_not():
    found = find_task_space([walks(1.0, 0), walks(-1.0, 1)], settings=QUICK)
    assert found.components == [0]
    assert found.worst[0] > 0.03
    assert found.worst[1] < -0.2
    assert found.nats.shape == (2, 3)
    assert found.whole.shape == (2,)
    assert found.whole.min() < 0  # the lean is in it


def test_a_habit_that_bodies_share_is_found_too():
    """The limit of it: what every body does alike cannot be told from what was meant."""
    found = find_task_space([walks(1.0, 0), walks(1.0, 1)], settings=QUICK)
    assert set(found.components) == {0, 1}
    assert found.whole.min() > found.worst.max()


def test_demonstrations_that_do_not_fit_are_refused():
    first = walks(1.0, 0)
    with pytest.raises(ValueError, match="of 1 body; expected those of two"):
        find_task_space([first])
    with pytest.raises(ValueError, match=r"the bodies have \[120, 10\] demonstrations"):
        find_task_space([first, first[:10]])
    shorter = DemonstrationDataset(first.observation[:, :11], first.action[:, :10])
    with pytest.raises(ValueError, match=r"\(S, A, T\) = \[\(3, 1, 20\), \(3, 1, 10\)\]"):
        find_task_space([first, shorter])
    with pytest.raises(ValueError, match=r"task\(s\) \[1\] were demonstrated by one body alone"):
        find_task_space([first, first[:20]], [[0] * 60 + [1] * 60, [0] * 20])
