"""Demonstrations keep their data exactly, hide the task from learners, and refuse bad episodes."""

import math
import re
import warnings
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from pemirl_trl.data import DemonstrationDataset, Provenance
from pemirl_trl.files import write_tensors

ROOT = Path(__file__).parents[2]
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


def test_from_rollouts_need_not_say_where_they_come_from(demos):
    assert DemonstrationDataset.from_rollouts(rollouts_of(demos)).provenance == Provenance()


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
        ((np.zeros((T + 1, 4)), np.zeros((T, A))), "episode 2: .* dimension 4 and 2; expected 3"),
        ((np.zeros(T + 1), np.zeros((T, A))), r"episode 2: .* shapes \(6,\) and \(5, 2\)"),
        ((np.full((T + 1, S), math.nan), np.zeros((T, A))), "observation is NaN .* in episode 2;"),
        ((np.zeros((T + 1, S)), np.full((T, A), 1e300)), "action is NaN or infinite in episode 2"),
    ],
)
def test_a_broken_episode_is_named(broken, message):
    with pytest.raises(ValueError, match=message):
        DemonstrationDataset.from_episodes([*episodes(2), broken, *episodes(1)])


@pytest.mark.parametrize(
    ("episode", "message"),
    [
        ((np.zeros((T + 1, S)) * 1j, np.zeros((T, A))), "observation is an array of complex128"),
        ((np.zeros((T + 1, S)), np.full((T, A), "1")), "action is an array of <U1"),
        ((np.zeros((T + 1, S)), np.full((T, A), None)), "action is an array of object"),
        ((np.zeros((T + 1, S)), [[0, 0], [0]]), "action is not an array"),
        ((np.zeros((T + 1, S)), torch.zeros(T, A) * 1j), "action is a tensor of torch.complex64"),
        ((np.ma.masked_less(np.zeros((T + 1, S)), 1), np.zeros((T, A))), "float64 with masked"),
        ((np.zeros((T + 1, S)), np.full((T, A), 2**60)), r"action holds integers beyond 2\^53"),
        ((1, 2, 3), r"episode 2 is a tuple; expected a pair"),
        (None, r"episode 2 is a NoneType; expected a pair"),
    ],
)
def test_what_are_no_real_numbers_is_refused_by_name(episode, message):
    with pytest.raises(ValueError, match=f"episode 2.*{message}|{message}"):
        DemonstrationDataset.from_episodes([*episodes(2), episode])


def test_a_dataset_keeps_no_graph():
    observation = torch.randn(M, T + 1, S, requires_grad=True)
    action = torch.randn(M, T, A, requires_grad=True)
    task = TensorDict({"goal": torch.randn(M, 2, requires_grad=True)}, [M])
    direct = DemonstrationDataset(observation, action, task=task)
    pairs = list(zip(observation, action, strict=True))
    built = DemonstrationDataset.from_episodes(pairs, task={"goal": task["goal"]})
    rollouts = rollouts_of(DemonstrationDataset(observation.detach(), action.detach(), task=task))
    rollouts["action"].requires_grad_()
    collected = DemonstrationDataset.from_rollouts(rollouts, PROVENANCE)
    for demos in (direct, built, collected):
        assert torch.equal(demos.action, action)
        for tensor in (demos.observation, demos.action, demos.tasks()["goal"]):
            assert not tensor.requires_grad


def test_a_dataset_takes_arrays_that_cannot_be_written_to():
    pairs = episodes()
    for pair in pairs:
        for array in pair:
            array.setflags(write=False)
    assert len(DemonstrationDataset.from_episodes(pairs)) == len(pairs)


def test_every_path_refuses_what_float32_cannot_tell_apart(tmp_path, monkeypatch):
    observation = torch.zeros(4, T + 1, S, dtype=torch.float64)
    observation[..., 1] = 4.2e6 + 0.05 * torch.arange(T + 1, dtype=torch.float64)
    action = torch.zeros(4, T, A)
    message = "observation feature 1 loses its precision in float32: in episode 0, its 6 distinct"
    with pytest.raises(ValueError, match=message):
        DemonstrationDataset.from_episodes(zip(observation, action, strict=True))
    rollouts = TensorDict(
        {
            "observation": observation[:, :-1],
            "action": action,
            "next": {"observation": observation[:, 1:]},
        },
        [4, T],
    )
    with pytest.raises(ValueError, match=message):
        DemonstrationDataset.from_rollouts(rollouts, PROVENANCE)
    minari = pytest.importorskip("minari")
    spaces = pytest.importorskip("gymnasium").spaces
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # on descriptive fields
        minari.create_dataset_from_buffers(
            "toy/wide-v0",
            [
                minari.data_collector.EpisodeBuffer(
                    id=0,
                    observations=observation[0].numpy(),
                    actions=action[0].numpy(),
                    rewards=np.zeros(T),
                    terminations=np.zeros(T, dtype=bool),
                    truncations=np.arange(T) == T - 1,
                )
            ],
            observation_space=spaces.Box(-np.inf, np.inf, (S,), np.float64),
            action_space=spaces.Box(-np.inf, np.inf, (A,), np.float32),
        )
    with pytest.raises(ValueError, match=f"toy/wide-v0: {message}"):
        DemonstrationDataset.from_minari("toy/wide-v0")


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
        ((o.tolist(), a, p), "observation is a list; expected a tensor"),
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
        ({"horizon": "5"}, "'horizon' is '5'; expected int"),
        ({"horizon": True}, "'horizon' is True; expected int"),
        ({"provenance": []}, r"'provenance' is \[\]; expected dict"),
        ({"provenance": {"author": "me"}}, r"unknown ones \['author'\]"),
        ({"provenance": {"seed": "3"}}, "'seed' is '3'; expected int or NoneType"),
        ({"provenance": {"extra": {"split": 1}}}, "extra: 'split' is 1; expected str"),
        ({"comment": ""}, r"unknown ones \['comment'\]"),
    ],
)
def test_files_that_contradict_themselves(demos, tmp_path, changed, message):
    header = {"schema_version": 1, "episodes": M, "horizon": T, "provenance": {}} | changed
    tensors = {"observation": demos.observation, "action": demos.action}
    write_tensors(tmp_path / "x", tensors, kind="demonstrations", header=header)
    with pytest.raises(ValueError, match=message) as raised:
        DemonstrationDataset.load(tmp_path / "x")
    assert str(tmp_path / "x") in str(raised.value)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["observation", "action", "reward"], r"lacks the tensors \[\] .* \['reward'\]"),
        (["observation", "action", "task"], r"unknown ones \['task'\]"),
        (["observation", "action", "task."], r"unknown ones \['task.'\]"),
        (["observation", "task.goal"], r"lacks the tensors \['action'\]"),
        (["observation", "action", "task.a", "task.a.b"], r"\['task.a'\] are tensors and groups"),
    ],
)
def test_tensors_that_are_no_part_of_the_schema_are_refused(demos, tmp_path, names, message):
    header = {"schema_version": 1, "episodes": M, "horizon": T, "provenance": {}}
    known = {"observation": demos.observation, "action": demos.action}
    tensors = {name: known.get(name, torch.zeros(M, 2)) for name in names}
    write_tensors(tmp_path / "x", tensors, kind="demonstrations", header=header)
    with pytest.raises(ValueError, match=message) as raised:
        DemonstrationDataset.load(tmp_path / "x")
    assert str(tmp_path / "x") in str(raised.value)


def test_a_task_of_another_number_of_episodes_is_refused(demos, tmp_path):
    header = {"schema_version": 1, "episodes": M, "horizon": T, "provenance": {}}
    tensors = {"observation": demos.observation, "action": demos.action, "task.a": torch.zeros(2)}
    write_tensors(tmp_path / "x", tensors, kind="demonstrations", header=header)
    with pytest.raises(ValueError, match=r"/x: task entries have shapes {'a': \(2,\)}; expected"):
        DemonstrationDataset.load(tmp_path / "x")


@pytest.mark.parametrize("path", sorted((ROOT / "data").glob("*_t*.safetensors")), ids=str)
def test_published_files_of_file_version_1_still_load(path):
    demos = DemonstrationDataset.load(path)
    assert demos.tasks().batch_size == (len(demos),)
    assert demos.provenance.code_version == "0.1.0"


def test_loading_validates(demos, tmp_path):
    header = {"schema_version": 1, "episodes": M, "horizon": T, "provenance": {}}
    observation = demos.observation.clone()
    observation[2, 0, 0] = math.nan
    tensors = {"observation": observation, "action": demos.action}
    write_tensors(tmp_path / "x", tensors, kind="demonstrations", header=header)
    with pytest.raises(ValueError, match="/x: observation is NaN or infinite in episode 2;"):
        DemonstrationDataset.load(tmp_path / "x")
