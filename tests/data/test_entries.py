"""Discrete actions and observations of several entries, from anyone's arrays."""

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from pemirl_trl import DemonstrationDataset, Provenance
from pemirl_trl.data import examine

M, T, S, A = 12, 6, 2, 4


def indices(seed=0):
    return np.random.default_rng(seed).integers(0, A, (M, T))


def observations():
    return np.random.default_rng(1).standard_normal((M, T + 1, S))


def data(actions=None, **options):
    actions = indices() if actions is None else actions
    pairs = list(zip(observations(), actions, strict=True))
    return DemonstrationDataset.from_episodes(pairs, **{"discrete_actions": A, **options})


@pytest.mark.parametrize(
    "form",
    [
        lambda a: a,
        lambda a: a[..., None],
        lambda a: a.astype(np.float32),
        lambda a: np.eye(A)[a],
        lambda a: np.eye(A, dtype=bool)[a],
    ],
    ids=["integers", "columns", "floats", "one-hot", "one-hot booleans"],
)
def test_choices_become_one_hot_however_they_are_stored(form):
    dataset = data(form(indices()))
    assert dataset.action.dtype == torch.float32
    assert torch.equal(dataset.action, torch.eye(A)[torch.from_numpy(indices())])
    assert dataset.discrete
    assert dataset.action_dim == A


@pytest.mark.parametrize("worst", [A, -1, 0.5, np.nan])
def test_what_is_no_choice_is_refused(worst):
    actions = indices().astype(float)
    actions[3, 2] = worst
    with pytest.raises(ValueError, match=r"episode 3: action .* integers from 0 to 3"):
        data(actions)


def test_integers_without_their_number_are_refused_with_the_cure():
    with pytest.raises(ValueError, match="discrete_actions says how many there are"):
        data(discrete_actions=None)


@pytest.mark.parametrize(
    ("change", "discrete"),
    [
        (lambda a: a, True),
        (lambda a: 2 * a, False),
        (lambda a: -a, False),
        (lambda a: torch.ones_like(a), False),
        (lambda a: torch.zeros_like(a), False),
        (lambda a: a[..., :1] * 0 + 1, False),  # one number that is always 1
        (lambda a: torch.cat([a[:, :4], 0 * a[:, 4:]], 1), True),  # padded
        (lambda a: torch.cat([0 * a[:, :1], a[:, 1:]], 1), False),
    ],
)
def test_only_one_hot_actions_are_choices(change, discrete):
    one_hot = torch.eye(A)[torch.from_numpy(indices())]
    observation = torch.randn(M, T + 1, S)
    assert DemonstrationDataset(observation, change(one_hot)).discrete == discrete


def test_rollouts_of_either_encoding():
    index = torch.from_numpy(indices())
    observation = torch.from_numpy(observations()).float()
    steps = {"observation": observation[:, :-1], "next": {"observation": observation[:, 1:]}}
    by_index = TensorDict({**steps, "action": index}, [M, T])
    one_hot = TensorDict({**steps, "action": torch.eye(A)[index].bool()}, [M, T])
    first = DemonstrationDataset.from_rollouts(by_index, Provenance("x"), discrete_actions=A)
    second = DemonstrationDataset.from_rollouts(one_hot, Provenance("x"))
    assert torch.equal(first.action, second.action)
    assert first.discrete
    square = TensorDict(  # T choices: what could be taken for one-hot rows is still an index
        {key: value[:A, :A] for key, value in by_index.exclude("action").items()}, [A, A]
    ).set("action", torch.eye(A).long())
    taken = DemonstrationDataset.from_rollouts(square, Provenance("x"), discrete_actions=A)
    assert torch.equal(taken.action.argmax(-1), torch.eye(A).long())


def test_files_and_minari_keep_choices(tmp_path, monkeypatch):
    minari = pytest.importorskip("minari")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    dataset = data()
    dataset.save(tmp_path / "choices.safetensors")
    assert torch.equal(
        DemonstrationDataset.load(tmp_path / "choices.safetensors").action, dataset.action
    )
    dataset.to_minari("choices-v0")
    stored = minari.load_dataset("choices-v0")
    assert stored.action_space.n == A
    assert np.array_equal(stored[0].actions, indices()[0])
    assert torch.equal(DemonstrationDataset.from_minari("choices-v0").action, dataset.action)


@pytest.mark.filterwarnings("ignore")  # minari's, on descriptive fields
def test_minari_data_of_dictionaries_and_of_choices_that_begin_later(tmp_path, monkeypatch):
    minari = pytest.importorskip("minari")
    spaces = pytest.importorskip("gymnasium").spaces
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    box = spaces.Box(-np.inf, np.inf, (S,), np.float32)
    seen, taken = observations().astype(np.float32), indices() + 2
    buffers = [
        minari.data_collector.EpisodeBuffer(
            id=i,
            observations={"place": seen[i], "goal": {"at": 2 * seen[i]}},
            actions=taken[i],
            rewards=np.zeros(T),
            terminations=np.zeros(T, dtype=bool),
            truncations=np.arange(T) == T - 1,
        )
        for i in range(M)
    ]
    minari.create_dataset_from_buffers(
        "later-v0",
        buffers,
        observation_space=spaces.Dict({"place": box, "goal": spaces.Dict({"at": box})}),
        action_space=spaces.Discrete(A, start=2),
    )
    keys = ["goal.at", "place"]
    loaded = DemonstrationDataset.from_minari("later-v0", observation_keys=keys)
    expected = torch.from_numpy(np.concatenate([2 * seen, seen], -1))
    assert torch.equal(loaded.observation, expected)
    assert torch.equal(loaded.action.argmax(-1), torch.from_numpy(indices()))
    with pytest.raises(ValueError, match=r"later-v0: .* entries \['goal.at', 'place'\]"):
        DemonstrationDataset.from_minari("later-v0")


@pytest.mark.parametrize("keys", [None, ["a", "c"], ["a", "a"], []])
def test_entries_that_are_not_there_are_answered_with_those_that_are(keys):
    episode = {"a": np.zeros((T + 1, 1)), "b": np.zeros((T + 1, 2, 2))}, np.zeros((T, A))
    with pytest.raises(ValueError, match=r"episode 0: observation has the entries \['a', 'b'\]"):
        DemonstrationDataset.from_episodes([episode], observation_keys=keys)


def test_keys_of_what_has_none_are_refused():
    with pytest.raises(ValueError, match="is one array; got observation_keys"):
        data(observation_keys=["a"])


def test_the_doctor_knows_choices():
    never = data(indices() % (A - 1))
    (finding,) = [f for f in examine(never) if "action" in f.what]
    assert finding.what == "discrete actions that are never taken"
    assert finding.where == "[3]"
    assert not [f for f in examine(data()) if "action" in f.what]
    with pytest.raises(ValueError, match="but the actions are 4 choices"):
        examine(data(), action_bounds=(-1, 1))
