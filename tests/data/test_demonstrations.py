"""Demonstrations keep their data exactly, hide the task from learners, and refuse bad episodes."""

import math
import re

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from pemirl_trl.data import DemonstrationDataset, Provenance
from pemirl_trl.files import write_tensors

M, T, S, A = 6, 5, 3, 2
PROVENANCE = Provenance("point_maze", 3, -5.5, "0.1", "collect task=point_maze", {"note": "x"})


@pytest.fixture
def demos():
    task = TensorDict({"goal": torch.randn(M, 2), "deep": {"sign": torch.randint(2, (M,))}}, [M])
    return DemonstrationDataset(torch.randn(M, T + 1, S), torch.randn(M, T, A), PROVENANCE, task)


def rollouts_of(demos):
    """[M, T] as a collector gives them, the task repeated at every step."""
    rollouts = demos.trajectories().clone().auto_batch_size_(2)
    rollouts["task"] = demos.tasks()[:, None].expand(M, T).clone()
    return rollouts


def assert_same(a, b):
    assert torch.equal(a.observation, b.observation)
    assert torch.equal(a.action, b.action)
    assert a.provenance == b.provenance
    assert (a.tasks() == b.tasks()).all()
    assert set(a.tasks().keys(True, True)) == set(b.tasks().keys(True, True))


def test_sizes(demos):
    assert (len(demos), demos.horizon, demos.observation_dim, demos.action_dim) == (M, T, S, A)


def test_trajectories_hold_what_a_learner_may_see_and_nothing_else(demos):
    td = demos.trajectories()
    assert td.batch_size == (M,)
    assert set(td.keys(True, True)) == {"observation", "action", ("next", "observation")}
    assert torch.equal(td["observation"], demos.observation[:, :T])
    assert torch.equal(td["next", "observation"], demos.observation[:, 1:])
    assert torch.equal(td["action"], demos.action)


@pytest.mark.parametrize(
    ("index", "rows"),
    [
        (2, [2]),
        (-1, [5]),
        (slice(1, 6, 2), [1, 3, 5]),
        ([4, 4, 0], [4, 4, 0]),
        (torch.tensor([3, 1]), [3, 1]),
        (torch.arange(M) > 3, [4, 5]),
    ],
)
def test_every_index_means_the_same_everywhere(demos, index, rows):
    assert torch.equal(demos.trajectories(index)["action"], demos.action[rows])
    assert torch.equal(demos.tasks(index)["goal"], demos.task["goal"][rows])
    assert torch.equal(demos[index].observation, demos.observation[rows])
    assert torch.equal(demos[index].tasks()["deep", "sign"], demos.task["deep", "sign"][rows])


def test_iteration_ends(demos):
    assert [len(one) for one in demos] == [1] * M
    with pytest.raises(IndexError):
        demos[M]


def test_file_round_trip(demos, tmp_path):
    demos.save(tmp_path / "demos.safetensors")
    assert_same(DemonstrationDataset.load(tmp_path / "demos.safetensors"), demos)
    assert [p.name for p in tmp_path.iterdir()] == ["demos.safetensors"]


def test_without_a_task_metrics_fail_loudly(demos, tmp_path):
    DemonstrationDataset(demos.observation, demos.action).save(tmp_path / "demos.safetensors")
    loaded = DemonstrationDataset.load(tmp_path / "demos.safetensors")
    assert loaded[1:].task is None
    with pytest.raises(ValueError, match="no ground-truth task"):
        loaded.tasks()


def test_minari_round_trip(demos, tmp_path, monkeypatch):
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    demos.to_minari("pemirl/point_maze/expert-v0", author="someone")
    assert_same(DemonstrationDataset.from_minari("pemirl/point_maze/expert-v0"), demos)
    episode = minari.load_dataset("pemirl/point_maze/expert-v0")[0]
    assert np.isnan(episode.rewards).all()
    assert episode.truncations.tolist() == [False] * (T - 1) + [True]
    assert not episode.terminations.any()


def test_minari_without_task_and_from_someone_else(demos, tmp_path, monkeypatch):
    pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    DemonstrationDataset(demos.observation, demos.action).to_minari("plain-v0")
    metadata = tmp_path / "plain-v0" / "data" / "metadata.json"
    assert '"pemirl_trl"' in metadata.read_text()
    metadata.write_text(metadata.read_text().replace('"pemirl_trl"', '"other"'))
    loaded = DemonstrationDataset.from_minari("plain-v0")
    assert loaded.task is None
    assert loaded.provenance == Provenance(environment="plain-v0")
    assert torch.equal(loaded.action, demos.action)


def test_from_rollouts_keeps_the_true_last_observation(demos):
    assert_same(DemonstrationDataset.from_rollouts(rollouts_of(demos), PROVENANCE), demos)


def test_from_rollouts_names_episodes_that_were_reset_or_changed_task(demos):
    rollouts = rollouts_of(demos)
    rollouts["observation"][4, 2] += 1  # a reset puts another state after step 1
    with pytest.raises(ValueError, match=r"episodes \[4\] were reset"):
        DemonstrationDataset.from_rollouts(rollouts, PROVENANCE)
    rollouts = rollouts_of(demos)
    rollouts["task", "goal"][1, 3:] += 1
    with pytest.raises(ValueError, match=r"episodes \[1\] changed their task"):
        DemonstrationDataset.from_rollouts(rollouts, PROVENANCE)
    assert DemonstrationDataset.from_rollouts(rollouts, PROVENANCE, task_key=None).task is None


# --- one's own episodes ------------------------------------------------------------------------


def episodes(count=4):
    return [(np.full((T + 1, S), i), np.full((T, A), -i)) for i in range(count)]


def test_from_episodes_takes_arrays_of_any_dtype_and_tasks():
    demos = DemonstrationDataset.from_episodes(
        episodes(), task={"goal": np.arange(8).reshape(4, 2)}
    )
    assert demos.observation.dtype == demos.action.dtype == torch.float32
    assert demos.observation[3].eq(3).all()
    assert demos.action[3].eq(-3).all()
    assert demos.tasks([2])["goal"].tolist() == [[4, 5]]


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        ((np.zeros((T, S)), np.zeros((T, A))), "episode 2: 5 observations for 5 actions"),
        ((np.zeros((T, S)), np.zeros((T - 1, A))), "episode 2: .* have length 5 and 4; expected 6"),
        ((np.zeros((T + 1, 4)), np.zeros((T, A))), "episode 2: .* dimension 4 and 2; expected 3"),
        ((np.zeros(T + 1), np.zeros((T, A))), r"episode 2: .* shapes \(6,\) and \(5, 2\)"),
        ((np.full((T + 1, S), math.nan), np.zeros((T, A))), "observation is NaN .* in episode 2;"),
        ((np.zeros((T + 1, S)), np.full((T, A), 1e300)), "action is NaN or infinite in episode 2"),
    ],
)
def test_a_broken_episode_is_named(broken, message):
    with pytest.raises(ValueError, match=message):
        DemonstrationDataset.from_episodes([*episodes(2), broken, *episodes(1)])


def test_many_broken_episodes_are_counted():
    bad = (np.zeros((T, S)), np.zeros((T, A)))
    with pytest.raises(ValueError, match=re.escape("episodes 1, 2, 3, 4, 5 ... (7 in all)")):
        DemonstrationDataset.from_episodes([*episodes(1), *[bad] * 7])
    with pytest.raises(ValueError, match="no episodes"):
        DemonstrationDataset.from_episodes([])


# --- tensors and files that break the schema ---------------------------------------------------


def test_tensors_that_break_the_schema(demos):
    o, a, p = demos.observation, demos.action, PROVENANCE
    infinite = TensorDict({"goal": torch.tensor([0.0] * (M - 1) + [math.inf])}, [M])
    dotted = TensorDict({"a.b": torch.zeros(M)}, [M])
    for arguments, message in [
        ((o.double(), a, p), r"float64; expected .* torch\.float32"),
        ((o[0], a, p), r"observation is \(6, 3\)"),
        ((o[:, :T], a, p), "6 episodes of 5 observations, 6 of 5 actions"),
        ((o[:3], a, p), "3 episodes of 6 observations, 6 of 5 actions"),
        ((o[:0], a[:0], p), "empty"),
        ((o, a, p, demos.tasks()[:2]), r"task has batch_size \[2\]; expected \[6\]"),
        ((o, a, p, infinite), "'goal' is NaN or infinite in episode 5"),
        ((o, a, p, dotted), "without '.' and '/'"),
    ]:
        with pytest.raises(ValueError, match=message):
            DemonstrationDataset(*arguments)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"schema_version": 99}, "schema 99; this version reads schema 1"),
        ({"horizon": 9}, "of 9 steps"),
    ],
)
def test_files_that_contradict_themselves(demos, tmp_path, changed, message):
    header = {"schema_version": 1, "episodes": M, "horizon": T, "provenance": {}} | changed
    tensors = {"observation": demos.observation, "action": demos.action}
    write_tensors(tmp_path / "x", tensors, kind="demonstrations", header=header)
    with pytest.raises(ValueError, match=message):
        DemonstrationDataset.load(tmp_path / "x")


def test_loading_validates(demos, tmp_path):
    header = {"schema_version": 1, "episodes": M, "horizon": T, "provenance": {}}
    observation = demos.observation.clone()
    observation[2, 0, 0] = math.nan
    tensors = {"observation": observation, "action": demos.action}
    write_tensors(tmp_path / "x", tensors, kind="demonstrations", header=header)
    with pytest.raises(ValueError, match="episode 2"):
        DemonstrationDataset.load(tmp_path / "x")
