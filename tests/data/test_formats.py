"""Demonstrations in the formats of others: what is read is what was written, and no code is run.

The files here are written by hand after the formats' documentation, which takes pyarrow and h5py
alone. Where imitation or LeRobot is installed (neither is a dependency), its own writer is read.
"""

import json
import pickle
import re

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.ipc
import pyarrow.parquet
import pytest
import torch

from pemirl_trl.data import DemonstrationDataset, examine

LENGTHS, S, A = (4, 6, 3), 3, 2


@pytest.fixture
def pairs():
    """Episodes of float32 numbers, which every format keeps exactly."""
    draw = np.random.default_rng(0)
    shapes = [((n + 1, S), (n, A)) for n in LENGTHS]
    return [tuple(draw.normal(size=s).astype(np.float32) for s in both) for both in shapes]


def assert_holds(data, pairs, terminated=None):
    assert data.lengths.tolist() == [len(action) for _, action in pairs]
    for i, (observation, action) in enumerate(pairs):
        assert np.array_equal(data.observation[i, : len(observation)], observation)
        assert np.array_equal(data.action[i, : len(action)], action)
    if terminated is not None:
        assert data.terminated.tolist() == list(terminated)


# --- arrays ------------------------------------------------------------------------------------


def test_arrays_of_one_length_and_of_several(tmp_path):
    draw = np.random.default_rng(1)
    observation, action = draw.normal(size=(5, 8, S)), draw.normal(size=(5, 7, A))
    np.savez(tmp_path / "even.npz", observation=observation, action=action)
    even = DemonstrationDataset.load(tmp_path / "even.npz")
    assert np.array_equal(even.observation, observation.astype(np.float32))
    length, ended = np.array([7, 2, 7, 3, 1]), np.array([True, True, False, False, True])
    arrays = {"observation": observation, "action": action, "length": length, "terminated": ended}
    np.savez(tmp_path / "uneven.npz", **arrays)
    uneven = DemonstrationDataset.load(tmp_path / "uneven.npz")
    cut = [(observation[i, : n + 1], action[i, :n]) for i, n in enumerate(length)]
    wanted = DemonstrationDataset.from_episodes(cut, terminated=ended.tolist())
    assert torch.equal(uneven.observation, wanted.observation)
    assert torch.equal(uneven.ended, wanted.ended)


def test_arrays_that_nobody_knows_are_named(tmp_path):
    np.savez(tmp_path / "other.npz", states=np.zeros(3))
    with pytest.raises(ValueError, match=r"other\.npz has the arrays \['states'\]; expected obs"):
        DemonstrationDataset.load(tmp_path / "other.npz")
    (tmp_path / "none.npz").write_bytes(b"text")
    with pytest.raises(ValueError, match=r"none\.npz is not a NumPy archive"):
        DemonstrationDataset.load(tmp_path / "none.npz")


# --- D4RL --------------------------------------------------------------------------------------


def d4rl(pairs, ended, *, following=False):
    """The layout, of episodes whose last state is recorded where ``following`` says so."""
    flags = np.concatenate([np.arange(len(a)) == len(a) - 1 for _, a in pairs])
    by_itself = np.repeat(ended, [len(a) for _, a in pairs])
    arrays = {
        "observations": np.concatenate([o[:-1] for o, _ in pairs]),
        "actions": np.concatenate([a for _, a in pairs]),
        "terminals": flags & by_itself,
        "timeouts": flags & ~by_itself,
        "rewards": np.zeros(len(flags)),
    }
    if following:
        arrays["next_observations"] = np.concatenate([o[1:] for o, _ in pairs])
    return arrays


ENDED = (True, False, True)


def test_d4rl_with_next_observations_is_whole(pairs, tmp_path):
    arrays = d4rl(pairs, ENDED, following=True)
    assert_holds(DemonstrationDataset.from_d4rl(arrays), pairs, ENDED)
    with h5py.File(tmp_path / "d.hdf5", "w") as file:
        for name, values in arrays.items():
            file[name] = values
        file["infos/goal"] = np.zeros(3)  # of another length, and none of ours
    assert_holds(DemonstrationDataset.load(tmp_path / "d.hdf5"), pairs, ENDED)
    np.savez(tmp_path / "d.npz", **arrays)
    assert_holds(DemonstrationDataset.load(tmp_path / "d.npz"), pairs, ENDED)


def test_d4rl_without_them_leaves_out_an_action_whose_result_nobody_saw(pairs):
    known = [(o[:-1], a[:-1]) for o, a in pairs]
    assert_holds(DemonstrationDataset.from_d4rl(d4rl(pairs, ENDED)), known, ENDED)


def test_d4rl_that_stops_inside_an_episode_was_cut_there(pairs):
    arrays = {name: values[:-1] for name, values in d4rl(pairs, ENDED, following=True).items()}
    *whole, (observation, action) = pairs
    cut = [*whole, (observation[:-1], action[:-1])]
    assert_holds(DemonstrationDataset.from_d4rl(arrays), cut, (True, False, False))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"timeouts": None}, "without timeouts nobody knows where a time limit cut"),
        ({"actions": np.zeros((2, A))}, "expected one row per step"),
        ({"terminals": np.zeros(13, bool)}, "episode 0 was reset on the way"),
    ],
)
def test_d4rl_errors(pairs, change, message):
    arrays = d4rl(pairs, ENDED, following=True) | change
    arrays = {name: values for name, values in arrays.items() if values is not None}
    with pytest.raises(ValueError, match=message):
        DemonstrationDataset.from_d4rl(arrays)


def test_a_broken_hdf5_file_is_named(tmp_path):
    (tmp_path / "broken.h5").write_bytes(b"text")
    with pytest.raises(ValueError, match=r"broken\.h5 is not a readable HDF5 file"):
        DemonstrationDataset.load(tmp_path / "broken.h5")


# --- imitation ---------------------------------------------------------------------------------


class Trajectory:
    """What imitation's own class has."""

    def __init__(self, obs, acts, terminal):
        self.obs, self.acts, self.terminal = obs, acts, terminal


def archive(path, pairs, ended, **more):
    """The npz files of imitation 0.3."""
    np.savez(
        path,
        obs=np.concatenate([o for o, _ in pairs]),
        acts=np.concatenate([a for _, a in pairs]),
        terminal=np.array(ended),
        indices=np.cumsum([len(a) for _, a in pairs[:-1]]),
        **more,
    )


def on_disk(folder, pairs, ended):
    """A folder of ``datasets.Dataset.save_to_disk``, in two files."""
    folder.mkdir()
    names = []
    for part in (slice(0, 2), slice(2, None)):
        rows, name = pairs[part], f"data-{len(names):05d}-of-00002.arrow"
        columns = {
            "obs": [o.tolist() for o, _ in rows],
            "acts": [a.tolist() for _, a in rows],
            "infos": [["{}"] * len(a) for _, a in rows],
            "terminal": list(ended[part]),
            "rews": [[0.0] * len(a) for _, a in rows],
        }
        table = pa.table(columns)
        with pa.ipc.new_stream(str(folder / name), table.schema) as stream:
            stream.write_table(table)
        names.append({"filename": name})
    (folder / "state.json").write_text(json.dumps({"_data_files": names, "_split": None}))
    (folder / "dataset_info.json").write_text("{}")


def test_imitation_in_memory_as_an_archive_and_on_disk(pairs, tmp_path):
    trajectories = [Trajectory(*pair, end) for pair, end in zip(pairs, ENDED, strict=True)]
    assert_holds(DemonstrationDataset.from_imitation(trajectories), pairs, ENDED)
    infos = np.array([{}] * sum(LENGTHS))  # pickled by NumPy, and never opened
    archive(tmp_path / "old.npz", pairs, ENDED, infos=infos)
    assert_holds(DemonstrationDataset.load(tmp_path / "old.npz"), pairs, ENDED)
    on_disk(tmp_path / "new", pairs, ENDED)
    assert_holds(DemonstrationDataset.load(tmp_path / "new"), pairs, ENDED)


def test_discrete_actions_need_their_number(pairs, tmp_path):
    choices = [(o, np.arange(len(a)) % 3) for o, a in pairs]
    archive(tmp_path / "d.npz", choices, ENDED)
    data = DemonstrationDataset.load(tmp_path / "d.npz", discrete_actions=3)
    assert data.discrete
    assert data.action[1].argmax(-1).tolist() == [0, 1, 2, 0, 1, 2]
    with pytest.raises(ValueError, match=r"d\.npz: .*discrete_actions says how many"):
        DemonstrationDataset.load(tmp_path / "d.npz")


def test_imitation_itself_wrote_it(pairs, tmp_path):
    serialize = pytest.importorskip("imitation.data.serialize", exc_type=ImportError)
    from imitation.data.types import Trajectory as Theirs

    theirs = [Theirs(o, a, None, end) for (o, a), end in zip(pairs, ENDED, strict=True)]
    serialize.save(tmp_path / "theirs", theirs)
    assert_holds(DemonstrationDataset.load(tmp_path / "theirs"), pairs, ENDED)
    assert_holds(DemonstrationDataset.from_imitation(theirs), pairs, ENDED)


# --- what runs code ----------------------------------------------------------------------------


class Runs:
    def __reduce__(self):
        return (pytest.fail, ("a pickle was opened",))


def test_pickles_are_refused_unopened(tmp_path):
    (tmp_path / "t.pkl").write_bytes(pickle.dumps([Runs()]))
    with pytest.raises(ValueError, match=r"t\.pkl is a pickle.*serialize\.save"):
        DemonstrationDataset.load(tmp_path / "t.pkl")
    (tmp_path / "t.npz").write_bytes(pickle.dumps([Runs()]))
    with pytest.raises(ValueError, match="not a NumPy archive"):
        DemonstrationDataset.load(tmp_path / "t.npz")
    objects = np.array([Runs(), None], dtype=object)
    np.savez(tmp_path / "o.npz", obs=objects, acts=np.zeros(2), terminal=True, indices=[])
    with pytest.raises(ValueError, match=r"o\.npz: 'obs' holds pickled objects"):
        DemonstrationDataset.load(tmp_path / "o.npz")


# --- LeRobot -----------------------------------------------------------------------------------

FEATURES = {
    "observation.state": {"dtype": "float32", "shape": [S]},
    "observation.images.top": {"dtype": "video", "shape": [4, 4, 3]},
    "action": {"dtype": "float32", "shape": [A]},
}
GRID = {"observation.grid": {"dtype": "float64", "shape": [2, 2]}}


def lerobot(folder, pairs, features=FEATURES, version="v3.0", **columns):
    """A dataset whose frames are the pairs' first observations; two files, in no good order."""
    (folder / "meta/episodes/chunk-000").mkdir(parents=True)
    (folder / "data/chunk-000").mkdir(parents=True)
    info = {"codebase_version": version, "fps": 10, "features": features}
    (folder / "meta/info.json").write_text(json.dumps(info))
    frames = [len(a) for _, a in pairs]
    index, step = (
        np.repeat(np.arange(len(pairs)), frames),
        np.concatenate([*map(np.arange, frames)]),
    )
    state, action = (np.concatenate([p[i][:n] for p, n in zip(pairs, frames, strict=True)])
                     for i in (0, 1))  # fmt: skip
    fixed = {
        "observation.state": pa.FixedSizeListArray.from_arrays(state.ravel(), S),
        "action": pa.FixedSizeListArray.from_arrays(action.ravel(), A),
    }
    table = pa.table({"episode_index": index, "frame_index": step, **fixed, **columns})
    first = frames[0]
    for number, part in enumerate((table.slice(first), table.slice(0, first))):
        pa.parquet.write_table(part, folder / f"data/chunk-000/file-{number:03d}.parquet")
    episodes = pa.table({"episode_index": np.arange(len(pairs)), "length": frames})
    pa.parquet.write_table(episodes, folder / "meta/episodes/chunk-000/file-000.parquet")


def test_lerobot_frames_without_what_the_last_action_led_to(pairs, tmp_path):
    lerobot(tmp_path / "robot", pairs)
    data = DemonstrationDataset.load(tmp_path / "robot")
    assert_holds(data, [(o[:-1], a[:-1]) for o, a in pairs])
    assert data.terminated is None
    assert "not read: observation.images.top (video)" in data.provenance.command
    cut = DemonstrationDataset.from_lerobot(tmp_path / "robot", terminated=False)
    assert cut.cut.tolist() == [True, False, True]


def test_lerobot_entries_are_chosen_in_their_order(pairs, tmp_path):
    grid = np.random.default_rng(1).normal(size=(sum(LENGTHS), 2, 2))
    lerobot(tmp_path / "r", pairs, FEATURES | GRID, **{"observation.grid": grid.tolist()})
    keys = ["observation.grid", "state"]
    data = DemonstrationDataset.from_lerobot(tmp_path / "r", observation_keys=keys)
    assert np.array_equal(data.observation[0, :4, :4], grid[:4].reshape(4, 4).astype(np.float32))
    assert np.array_equal(data.observation[0, :4, 4:], pairs[0][0][:4])
    with pytest.raises(ValueError, match=r"entries \['state', 'grid'\].*got None"):
        DemonstrationDataset.load(tmp_path / "r")
    with pytest.raises(ValueError, match=r"images\.top is a video, which is not decoded"):
        DemonstrationDataset.from_lerobot(tmp_path / "r", observation_keys=["images.top"])


def test_lerobot_without_actions_has_states_alone(pairs, tmp_path):
    features = {name: feature for name, feature in FEATURES.items() if name != "action"}
    lerobot(tmp_path / "r", pairs, features)
    assert DemonstrationDataset.load(tmp_path / "r").action.shape == (3, 5, 0)


def test_lerobot_errors(pairs, tmp_path):
    lerobot(tmp_path / "old", pairs, version="v2.1")
    with pytest.raises(ValueError, match=r"version v2\.1; expected v3\.x.*convert_dataset_v21"):
        DemonstrationDataset.load(tmp_path / "old")
    lerobot(tmp_path / "part", pairs)
    (tmp_path / "part/data/chunk-000/file-001.parquet").unlink()
    message = "states 4 frames of episode 0, and data holds none (1 such episodes)"
    with pytest.raises(ValueError, match=re.escape(message)):
        DemonstrationDataset.load(tmp_path / "part")
    (tmp_path / "part/data/chunk-000/file-000.parquet").unlink()
    with pytest.raises(FileNotFoundError, match="has no frames"):
        DemonstrationDataset.load(tmp_path / "part")


def test_lerobot_itself_wrote_it(pairs, tmp_path):
    """With a shape of (1,), which it stores as a plain number, and a matrix."""
    theirs = pytest.importorskip("lerobot.datasets.lerobot_dataset", exc_type=ImportError)
    shapes = {"observation.state": (S,), "observation.one": (1,), "observation.grid": (2, 2)}
    features = {
        name: {"dtype": "float32", "shape": shape, "names": None}
        for name, shape in {**shapes, "action": (A,)}.items()
    }
    dataset = theirs.LeRobotDataset.create(
        "a/b", 10, features, root=tmp_path / "r", use_videos=False
    )
    for observation, action in pairs:
        for o, a in zip(observation[:-1], action, strict=True):
            seen = {"observation.one": o[:1], "observation.grid": np.tile(o[:2], (2, 1))}
            dataset.add_frame({"observation.state": o, **seen, "action": a, "task": "do it"})
        dataset.save_episode()
    dataset.finalize()
    keys = ["grid", "one", "state"]
    data = DemonstrationDataset.from_lerobot(tmp_path / "r", observation_keys=keys)
    wanted = [(o[:-1][:, [0, 1, 0, 1, 0, 0, 1, 2]], a[:-1]) for o, a in pairs]
    assert_holds(data, wanted)


# --- which format it is ------------------------------------------------------------------------


def test_minari_by_its_name(pairs, tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    DemonstrationDataset.from_episodes(pairs, terminated=ENDED).to_minari("mine-v0")
    assert_holds(DemonstrationDataset.load("minari:mine-v0"), pairs, ENDED)
    with pytest.raises(FileNotFoundError, match=r"no Minari dataset yours-v0.*\['mine-v0'\]"):
        DemonstrationDataset.load("minari:yours-v0")


def test_folders_that_are_no_dataset(tmp_path):
    (tmp_path / "notes.txt").touch()
    with pytest.raises(ValueError, match=r"folder with \['notes.txt'\], of no format"):
        DemonstrationDataset.load(tmp_path)
    (tmp_path / "dataset_dict.json").touch()
    with pytest.raises(ValueError, match="a set of several datasets"):
        DemonstrationDataset.load(tmp_path)


# --- without actions ---------------------------------------------------------------------------


def test_states_alone_are_kept_saved_and_told(pairs, tmp_path):
    data = DemonstrationDataset.from_episodes([(o, None) for o, _ in pairs], terminated=ENDED)
    assert data.action.shape == (3, 6, 0)
    data.save(tmp_path / "states.safetensors")
    again = DemonstrationDataset.load(tmp_path / "states.safetensors")
    assert_holds(again, [(o, a[:, :0]) for o, a in pairs], ENDED)
    told = [finding.what for finding in examine(again, action_bounds=(-1, 1))]
    assert "no actions were recorded" in told
    assert not any("padded" in what for what in told)
