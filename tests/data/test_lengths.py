"""Demonstrations of several lengths: padding that nobody reads, ends that are remembered."""

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from pemirl_trl import DemonstrationDataset, Provenance
from pemirl_trl.data import examine

S, A = 2, 1
LENGTHS = [5, 3, 1, 4]


def episode(length, start=0.0):
    """Positions start, start + 1, ... and actions 1, 2, ...: no two steps are alike."""
    at = start + torch.arange(length + 1.0)
    return torch.stack([at, -at], -1), torch.arange(1.0, length + 1).unsqueeze(-1)


@pytest.fixture
def demos():
    return DemonstrationDataset.from_episodes([episode(n, 10.0 * i) for i, n in enumerate(LENGTHS)])


def assert_same(a, b):
    for name in ("observation", "action", "length", "terminated"):
        x, y = getattr(a, name), getattr(b, name)
        assert (x is None) == (y is None), name
        assert x is None or torch.equal(x, y), name


def test_shorter_episodes_are_padded_and_masked(demos):
    assert demos.horizon == 5
    assert demos.lengths.tolist() == LENGTHS
    batch = demos.trajectories()
    assert batch["mask"].sum(1).tolist() == LENGTHS
    assert batch["observation"][1, :, 0].tolist() == [10, 11, 12, 13, 13]
    assert batch["next", "observation"][1, :, 0].tolist() == [11, 12, 13, 13, 13]
    assert batch["action"][1, :, 0].tolist() == [1, 2, 3, 0, 0]
    assert torch.equal(demos.trajectories([2])["mask"], batch["mask"][2:3])


def test_episodes_of_one_length_are_what_they_were():
    demos = DemonstrationDataset.from_episodes([episode(4), episode(4, 5.0)])
    assert demos.length is None
    assert demos.terminated is None
    keys = {"observation", "action", ("next", "observation")}
    assert set(demos.trajectories().keys(True, True)) == keys
    # Of the longest ones of several lengths, nobody is told that others were shorter.
    several = DemonstrationDataset.from_episodes([episode(4), episode(4, 5.0), episode(2)])
    assert set(several[:2].trajectories().keys(True, True)) == keys
    assert torch.equal(several[:2].observation, demos.observation)


def test_what_is_shorter_has_ended_unless_somebody_says_that_it_was_cut(demos):
    assert demos.ended.tolist() == [False, True, True, True]
    assert not demos.cut.any()
    pairs = [episode(n) for n in LENGTHS]
    cut = DemonstrationDataset.from_episodes(pairs, terminated=False)
    assert cut.cut.tolist() == [False, True, True, True]
    each = DemonstrationDataset.from_episodes(pairs, terminated=[True, True, False, True])
    assert each.ended.tolist() == [False, True, False, True]  # the first one lasts to T
    assert each.cut.tolist() == [False, False, True, False]
    # With a longer horizon the first one ended before it, as its flag says.
    assert each.padded(8).ended.tolist() == [True, True, False, True]
    assert demos.padded(8).ended.all()
    with pytest.raises(ValueError, match="terminated has 2 entries; expected one, or one for each"):
        DemonstrationDataset.from_episodes(pairs, terminated=[True, False])


def test_an_end_goes_on_where_it_was(demos):
    batch = demos.with_absorbing_states(7).trajectories()
    assert "mask" not in batch
    ended = torch.arange(7) >= torch.tensor(LENGTHS).unsqueeze(-1)
    assert torch.equal(batch["absorbing"], ended)
    assert torch.equal(batch["observation"][..., -1] == 1, ended)
    assert batch["observation"][1, :, 0].tolist() == [10, 11, 12, 13, 13, 13, 13]
    # The step that leads to the end begins before it, and sees it.
    assert batch["next", "observation"][1, :, -1].tolist() == [0, 0, 1, 1, 1, 1, 1]
    assert (batch["action"][ended] == 0).all()
    assert torch.equal(batch["observation"][:, 1:], batch["next", "observation"][:, :-1])


def test_what_was_cut_does_not_go_on():
    pairs = [episode(n) for n in LENGTHS]
    demos = DemonstrationDataset.from_episodes(pairs, terminated=[False, True, False, True])
    batch = demos.with_absorbing_states().trajectories()
    assert batch["absorbing"].sum(1).tolist() == [0, 2, 0, 1]
    assert batch["mask"].sum(1).tolist() == [5, 5, 1, 5]
    assert (batch["observation"][2, :, -1] == 0).all()


def test_absorbing_states_of_absorbing_states_are_the_same(demos):
    once = demos.with_absorbing_states(7)
    assert once.with_absorbing_states(7) is once
    later = demos.with_absorbing_states().with_absorbing_states(7).trajectories()
    # The one that lasted to the shorter horizon was not known to have ended there.
    rows = torch.tensor(LENGTHS) < 5
    expected = once.trajectories()["observation"][rows]
    assert torch.equal(later["observation"][rows], expected)
    with pytest.raises(ValueError, match="go on in absorbing states after their end; save those"):
        once.save("nowhere")


def test_lengths_and_ends_travel_through_files(demos, tmp_path):
    pairs = [episode(n) for n in LENGTHS]
    said = DemonstrationDataset.from_episodes(pairs, terminated=[True, True, False, True])
    for i, data in enumerate((demos, said, said[1:], said.padded(9))):
        data.save(tmp_path / f"{i}.safetensors")
        assert_same(DemonstrationDataset.load(tmp_path / f"{i}.safetensors"), data)


def test_minari_tells_an_end_from_a_cut(tmp_path, monkeypatch):
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    pairs = [episode(n, 0.5) for n in LENGTHS]
    said = DemonstrationDataset.from_episodes(pairs, terminated=[False, True, False, True])
    said.to_minari("several-v0")
    assert_same(DemonstrationDataset.from_minari("several-v0"), said)
    stored = list(minari.load_dataset("several-v0").iterate_episodes())
    assert [len(one.actions) for one in stored] == LENGTHS
    assert [bool(one.terminations[-1]) for one in stored] == [False, True, False, True]
    assert [bool(one.truncations[-1]) for one in stored] == [True, False, True, False]


def rolled_out(done, terminated):
    """Rollouts ``[2, 4]`` that are reset after an end, as a batched environment's are."""
    observation = torch.arange(8.0).view(2, 4, 1)
    following = observation + 0.5
    following[:, :-1] = torch.where(done[:, :-1].unsqueeze(-1), 100.0, observation[:, 1:])
    flags = {"done": done.unsqueeze(-1), "terminated": terminated.unsqueeze(-1)}
    return TensorDict(
        {
            "observation": observation,
            "action": observation + 1,
            "next": {"observation": following, **flags},
            "task": {"goal": torch.tensor([[0.0, 0.0, 9.0, 9.0], [2.0] * 4]).unsqueeze(-1)},
        },
        [2, 4],
    )


def test_from_rollouts_takes_the_first_episode_of_each_row():
    done = torch.tensor([[False, True, False, True], [False, False, False, True]])
    terminated = done & torch.tensor([[True], [False]])
    demos = DemonstrationDataset.from_rollouts(rolled_out(done, terminated), Provenance())
    assert demos.lengths.tolist() == [2, 4]
    assert demos.ended.tolist() == [True, False]
    assert demos.observation[0].flatten().tolist() == [0, 1, 100, 100, 100]
    assert demos.tasks()["goal"].tolist() == [[0], [2]]
    cut = DemonstrationDataset.from_rollouts(rolled_out(done, ~done), Provenance())
    assert cut.cut.tolist() == [True, False]


def test_from_rollouts_keeps_the_horizon_though_all_ended_before():
    done = torch.tensor([[False, True, False, True], [True, False, False, False]])
    demos = DemonstrationDataset.from_rollouts(rolled_out(done, done), Provenance())
    assert (demos.horizon, demos.lengths.tolist()) == (4, [2, 1])
    rollouts = rolled_out(done, done).set("absorbing", done)
    with pytest.raises(ValueError, match="from the environment itself, without AbsorbingState"):
        DemonstrationDataset.from_rollouts(rollouts, Provenance())


def test_from_rollouts_refuses_what_stopped_at_the_first_end():
    """EnvBase.rollout does that unless told otherwise, and all demonstrations would be cut."""
    done = torch.tensor([[False, False, False, True], [False] * 4])
    with pytest.raises(ValueError, match=r"stopped at step 4, where episodes \[0\] were done, and"):
        DemonstrationDataset.from_rollouts(rolled_out(done, done), Provenance(), task_key=None)
    every = torch.tensor([[False, False, False, True]] * 2)
    whole = rolled_out(every, every)
    assert len(DemonstrationDataset.from_rollouts(whole, Provenance(), task_key=None)) == 2


def test_from_rollouts_takes_episodes_of_one_step():
    none = torch.zeros(2, 4, dtype=torch.bool)
    demos = DemonstrationDataset.from_rollouts(rolled_out(none, none)[:, :1], Provenance())
    assert demos.horizon == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"length": torch.tensor([5, 3, 0, 4])}, "length goes from 0 to 5; expected 1 to 5"),
        ({"length": torch.tensor([6, 3, 1, 4])}, "length goes from 1 to 6"),
        ({"length": torch.ones(4)}, r"length is \(4,\) torch.float32; expected \[4\] torch.int64"),
        ({"terminated": torch.ones(3, dtype=torch.bool)}, r"terminated is \(3,\) torch.bool; expe"),
        ({"length": [5, 3, 1, 4]}, "length is a list"),
    ],
)
def test_wrong_lengths_are_refused(demos, change, message):
    with pytest.raises(ValueError, match=message):
        DemonstrationDataset(demos.observation, demos.action, **change)


def test_a_shorter_horizon_is_refused(demos):
    with pytest.raises(ValueError, match="got demonstrations of 5 steps; expected at most 4"):
        demos.padded(4)
    with pytest.raises(ValueError, match="got demonstrations of 5 steps; expected at most 4"):
        DemonstrationDataset.from_episodes([episode(5), episode(2)], horizon=4)


# --- what is suspicious ------------------------------------------------------------------------


def walks(lengths, seed=0, **options):
    rng = np.random.default_rng(seed)
    pairs = []
    for n in lengths:
        action = rng.uniform(-1, 1, (n, A))
        pairs.append((np.cumsum(rng.standard_normal((n + 1, S)), 0), action))
    return DemonstrationDataset.from_episodes(pairs, **options)


def test_padding_is_not_suspicious():
    """Neither as idle last steps, nor as a slower rate, nor as small actions."""
    lengths = [30] * 10 + [3] * 10
    assert examine(walks(lengths, terminated=True), (-1, 1)) == []
    assert examine(walks(lengths, terminated=True).padded(400)) == []


def test_unexplained_ends_are_said():
    (finding,) = examine(walks([30] * 10 + [7] * 5))
    assert "nobody says whether the short ones ended or were cut" in str(finding)
    assert "5 are shorter than 30 steps" in str(finding)
    assert not [f for f in examine(walks([30] * 10 + [7] * 5, terminated=False))]


def test_a_misaligned_last_action_is_seen_at_any_length():
    demos = walks([30, 9, 12, 20] * 3, terminated=True)
    action = demos.action.clone()
    action[torch.arange(12), demos.lengths - 1] = 0.0
    broken = DemonstrationDataset(
        demos.observation, action, length=demos.length, terminated=demos.terminated
    )
    assert any("the last action is all zero" in str(finding) for finding in examine(broken))
