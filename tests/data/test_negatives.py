"""The buffer holds exactly the last iterations, each step with its own context and log-prob."""

import pytest
import torch
from tensordict import TensorDict

from pemirl_trl.data import NEGATIVE_KEYS, Negatives, gather_steps

N, T = 4, 7


def rollouts(iteration):
    """Every number of a step says which iteration, trajectory and time it is from."""
    code = (1000 * iteration + 10 * torch.arange(N)[:, None] + torch.arange(T)).float()  # [N, T]
    wide = code[..., None].expand(N, T, 3).clone()
    step = {"observation": wide, "action": -wide, "context": wide + 0.5, "action_log_prob": code}
    following = {"observation": wide + 0.25, "reward": code[..., None]}
    return TensorDict(
        step | {"next": following, "reward": code[..., None]}, [N, T], names=[None, "time"]
    )


def filled(iterations, capacity=3):
    negatives = Negatives(capacity)
    for iteration in range(iterations):
        negatives.add(rollouts(iteration))
    return negatives


def iterations_in(sample):
    return set((sample["observation"][..., 0] // 1000).long().flatten().tolist())


@pytest.mark.parametrize("iterations", [1, 2, 3, 4, 7])
@pytest.mark.parametrize("last", [None, 1, 2, 3])
def test_samples_come_from_exactly_the_last_iterations(iterations, last):
    negatives = filled(iterations)
    assert len(negatives) == min(iterations, 3)
    held = min(iterations, 3) if last is None else min(iterations, last)
    expected = set(range(iterations - held, iterations))
    assert iterations_in(negatives.sample(200, last=last)) == expected


@pytest.mark.parametrize("steps", [None, 5])
def test_a_step_stays_together(steps):
    sample = filled(5).sample(50, steps=steps)
    assert sample.batch_size == (50, steps or T)
    assert set(sample.keys(True, True)) == set(NEGATIVE_KEYS)
    code = sample["action_log_prob"][..., None]
    assert torch.equal(sample["observation"], code.expand(-1, -1, 3))
    assert torch.equal(sample["action"], -sample["observation"])
    assert torch.equal(sample["context"], sample["observation"] + 0.5)
    assert torch.equal(sample["next", "observation"], sample["observation"] + 0.25)
    trajectory = code.squeeze(-1) // 10
    assert torch.equal(trajectory, trajectory[:, :1].expand_as(trajectory))  # one per row


def test_trajectories_and_times_are_uniform():
    negatives = filled(4)
    code = negatives.sample(20_000, steps=1)["action_log_prob"].flatten().long()
    cells = 3 * N * T
    counts = torch.unique(code, return_counts=True)[1].double()
    assert counts.numel() == cells
    chi_square = ((counts - 20_000 / cells) ** 2 / (20_000 / cells)).sum().item()
    assert abs(chi_square - (cells - 1)) < 4 * (2 * (cells - 1)) ** 0.5  # four deviations


def test_memory_is_allocated_once_and_not_shared_with_the_rollouts():
    negatives = filled(1)
    address = negatives._ring["observation"].data_ptr()
    added = rollouts(1)
    negatives.add(added)
    added.zero_()
    for iteration in range(2, 9):
        negatives.add(rollouts(iteration))
    assert negatives._ring["observation"].data_ptr() == address
    added = rollouts(9)
    negatives.add(added)
    added.zero_()
    assert iterations_in(negatives.sample(100, last=1)) == {9}


@pytest.mark.parametrize("iterations", [0, 2, 8])
def test_resumed_buffer_draws_the_same_and_goes_on_the_same(iterations):
    straight, resumed = filled(iterations), Negatives(3)
    resumed.load_state_dict({k: v.clone() for k, v in straight.state_dict().items()})
    assert len(resumed) == len(straight)
    assert all(len(v) == len(straight) for v in straight.state_dict().values())
    for iteration in range(iterations, iterations + 5):
        straight.add(rollouts(iteration))
        resumed.add(rollouts(iteration))
        draws = [
            negatives.sample(30, steps=4, generator=torch.Generator().manual_seed(iteration))
            for negatives in (straight, resumed)
        ]
        assert (draws[0] == draws[1]).all()


def test_a_smaller_buffer_keeps_the_newest():
    smaller = Negatives(2)
    smaller.load_state_dict(filled(6, capacity=5).state_dict())
    assert iterations_in(smaller.sample(100)) == {4, 5}


def test_no_gradient_is_kept():
    collected = rollouts(0)
    collected["action_log_prob"].requires_grad_()
    negatives = Negatives(1)
    negatives.add(collected)
    assert not negatives.sample(2)["action_log_prob"].requires_grad


def test_gather_steps_equals_indexing_and_serves_demonstrations_too():
    whole = rollouts(1).select(*NEGATIVE_KEYS)
    rows, times = torch.tensor([3, 0]), torch.tensor([[6, 0, 0], [1, 2, 3]])
    for trajectories in (whole, whole.copy().auto_batch_size_(1)):
        picked = gather_steps(trajectories, rows, times)
        assert picked.batch_size == (2, 3)
        for i in range(2):
            for j in range(3):
                assert (picked[i, j] == whole[rows[i], times[i, j]]).all()


def test_misuse_is_explained():
    negatives = Negatives(2)
    with pytest.raises(ValueError, match="no rollouts yet"):
        negatives.sample(1)
    with pytest.raises(ValueError, match=r"lack \['context'\]"):
        negatives.add(rollouts(0).exclude("context"))
    with pytest.raises(ValueError, match=r"batch_size \[28\]"):
        negatives.add(rollouts(0).reshape(-1))
    negatives.add(rollouts(0))
    with pytest.raises(ValueError, match=r"batch_size \[2, 7\]; expected \[4, 7\]"):
        negatives.add(rollouts(0)[:2])
    for last in (0, 3):
        with pytest.raises(ValueError, match=f"last is {last}; expected 1 to 2"):
            negatives.sample(1, last=last)
    with pytest.raises(ValueError, match="capacity is 0"):
        Negatives(0)
