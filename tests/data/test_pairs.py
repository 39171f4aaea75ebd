"""Each demonstration is paired with others of its task by other bodies."""

import pytest
import torch

from pemirl_trl import DemonstrationDataset
from pemirl_trl.data import pair_by_task

TASK = [0, 0, 0, 1, 1, 1]
BODY = [0, 1, 2, 0, 1, 1]


@pytest.fixture
def data():
    """Six demonstrations whose observations say which one they are."""
    observation = torch.arange(6.0)[:, None, None].expand(6, 4, 2).clone()
    return DemonstrationDataset(observation, torch.zeros(6, 3, 1))


def test_partners_share_the_task_and_not_the_body(data):
    pairs = pair_by_task(data, TASK, BODY, copies=20)
    own = pairs.trajectories["observation"][:, 0, 0].long()
    shown = pairs.trajectories["shown", "observation"][:, 0, 0].long()
    assert torch.equal(own, pairs.rows)
    task, body = torch.tensor(TASK), torch.tensor(BODY)
    assert (task[own] == task[shown]).all()
    assert (body[own] != body[shown]).all()
    # Every pair that there can be is drawn: of 1 x 2 partners twenty times, say.
    legal = {
        (i, j) for i in range(6) for j in range(6) if TASK[i] == TASK[j] and BODY[i] != BODY[j]
    }
    assert set(zip(own.tolist(), shown.tolist(), strict=True)) == legal


def test_of_one_body_another_demonstration_is_shown(data):
    pairs = pair_by_task(data, TASK, [0] * 6)
    own, shown = (
        pairs.trajectories[key][:, 0, 0] for key in ("observation", ("shown", "observation"))
    )
    assert (own != shown).all()
    assert len(pairs.rows) == 18


def test_draws_are_those_of_the_seed(data):
    first, again, other = (
        pair_by_task(data, TASK, BODY, copies=9, seed=seed).trajectories["shown", "observation"]
        for seed in (0, 0, 1)
    )
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_a_task_without_a_partner_is_named(data):
    with pytest.raises(ValueError, match=r"task\(s\) \[1\] were demonstrated by one body alone"):
        pair_by_task(data, TASK, [0, 1, 2, 3, 3, 3])
    with pytest.raises(ValueError, match=r"task\(s\) \[7\] were demonstrated once"):
        pair_by_task(data, [0, 0, 0, 1, 1, 7], [0] * 6)
    with pytest.raises(ValueError, match=r"body_of has the shape \[2\]; expected one number"):
        pair_by_task(data, TASK, [0, 1])
