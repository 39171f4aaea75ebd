"""A reward's file holds all that it takes to ask it, and is compared with itself when read."""

import json

import numpy as np
import pytest
import torch
from safetensors import safe_open

from pemirl_trl import (
    Card,
    DemonstrationDataset,
    ModelConfig,
    PEMIRLModel,
    PortableReward,
    Standardize,
    TrainingFamily,
    infer,
    load_card,
    load_model,
    load_reward,
    save_model,
    save_reward,
)
from pemirl_trl.files import read_weights, save_weights, write_tensors

SIZES = {"context_dim": 2, "encoder_hidden": (5,), "policy_hidden": (4,), "reward_hidden": (3,)}
CARD = Card(
    domain="toy",
    data_sha256="0" * 64,
    settings={"method": "robust", "training": {"iterations": 3}},
    measures={"return": -1.5, "episodes": 2},
    licence="MIT",
    command="pemirl export_reward",
    versions={"torch": "2"},
)


def trained(config=None, **changed):
    torch.manual_seed(0)
    standardize = Standardize(torch.tensor([1.0, -2.0, 3.0]), torch.tensor([2.0, 0.5, 1.0]))
    model = PEMIRLModel(3, 2, 4, ModelConfig(**(config or SIZES), **changed), standardize)
    model.family = TrainingFamily.fit(
        torch.randn(6, 2), torch.randn(6, 5, 3), model.standardize.scale
    )
    return model


def one():
    return DemonstrationDataset(torch.randn(1, 5, 3), torch.randn(1, 4, 2))


@pytest.fixture
def file(tmp_path):
    save_reward(trained(), tmp_path / "r.safetensors", card=CARD)
    return tmp_path / "r.safetensors"


def test_r_f_and_m_are_those_of_the_model_to_the_bit(file):
    model, reward, demonstration = trained(), load_reward(file), one()
    inferred, expected = infer(reward, demonstration), infer(model, demonstration)
    assert torch.equal(inferred.context, expected.context)
    assert inferred.distance == expected.distance
    s, following, m = torch.randn(7, 3), torch.randn(7, 3), expected.context
    with torch.no_grad():
        r = model.reward.reward(s, m)
        h, h_next = (model.reward.potential(x, m) for x in (s, following))
    assert torch.equal(reward(s, m), r)
    assert torch.equal(reward.potential(s, m), h)
    assert torch.equal(reward.shaped(s, following, m), r + 0.99 * h_next - h)
    assert torch.equal(inferred.reward(s), r)


def test_the_map_of_observations_is_inside(file):
    """In raw units: of a reward without a map, the same numbers come from mapped states."""
    reward, s, m = load_reward(file), torch.randn(4, 3), torch.tensor([0.3, -0.1])
    mapped = (s - torch.tensor([1.0, -2.0, 3.0])) / torch.tensor([2.0, 0.5, 1.0])
    expected = reward.reward.reward_net(mapped, m.expand(4, 2))
    torch.testing.assert_close(reward(s, m), expected)


def test_numbers_of_any_kind_are_taken(file):
    reward, s = load_reward(file), np.arange(6.0).reshape(2, 3)
    expected = reward(torch.tensor(s, dtype=torch.float32), torch.zeros(2))
    assert torch.equal(reward(s, np.zeros(2)), expected)
    assert torch.equal(reward(s.tolist(), [0, 0]), expected)
    assert expected.shape == (2, 1)
    assert reward([0.0, 0.0, 0.0], [0, 0]).shape == (1,)


def test_it_has_gradients_of_states_alone(file):
    reward = load_reward(file)
    s = torch.randn(3, requires_grad=True)
    reward(s, torch.zeros(2)).backward()
    assert s.grad.abs().sum() > 0
    assert not any(p.requires_grad for p in reward.parameters())


def test_it_holds_no_policy_and_any_reader_can_open_it(file):
    with safe_open(file, framework="pt") as opened:
        names = set(opened.keys())
    assert {name.split(".")[1] for name in names} == {"standardize", "encoder", "reward"}
    apart = {".".join(name.split(".")[:3]) for name in names}
    assert {"model.reward.reward_net", "model.reward.potential_net"} <= apart


def test_the_card_is_kept(file, tmp_path):
    assert load_card(file) == CARD == load_reward(file).card
    again = tmp_path / "again"
    save_reward(load_reward(file), again)
    assert load_card(again) == CARD
    assert again.read_bytes() == file.read_bytes()


def test_a_whole_model_gives_its_reward(tmp_path):
    model, s, m = trained(), torch.randn(4, 3), torch.zeros(2)
    save_model(tmp_path / "model", model, card=CARD)
    reward = load_reward(tmp_path / "model")
    assert torch.equal(reward(s, m), model.reward.reward(s, m).detach())
    assert reward.card == CARD
    assert load_model(tmp_path / "model").family is not None


def test_a_reward_is_not_taken_for_a_model(file):
    with pytest.raises(ValueError, match=r"a reward without a policy: pemirl_trl\.load_reward"):
        load_model(file)


def test_a_reward_without_contexts_is_one_of_states(tmp_path):
    model = PEMIRLModel(3, 2, 4, ModelConfig(**{**SIZES, "context_dim": 0}))
    save_reward(model, tmp_path / "airl")
    assert load_reward(tmp_path / "airl")(torch.zeros(5, 3), []).shape == (5, 1)


def test_gail_has_none(tmp_path):
    model = PEMIRLModel(3, 2, 4, ModelConfig(**SIZES, reward="gail"))
    with pytest.raises(ValueError, match="has no reward r"):
        save_reward(model, tmp_path / "gail")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("observation", "m", "message"),
    [
        (torch.zeros(4, 2), torch.zeros(2), r"got observations \[4, 2\]; expected \[..., 3\]"),
        (torch.zeros(4, 3), torch.zeros(3), r"got m \[3\]; expected \[..., 2\]"),
        (torch.zeros(4, 5, 3), torch.zeros(4, 2), "for one context per rollout"),
    ],
)
def test_wrong_shapes_are_said(file, observation, m, message):
    with pytest.raises(ValueError, match=message):
        load_reward(file)(observation, m)


def rewritten(file, change):
    tensors, metadata = read_weights(file)
    write_tensors(file, tensors, kind="weights", header={"metadata": change(metadata)})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda m: {**m, "card": "{"}, "the card in .* is damaged: not JSON"),
        (lambda m: {**m, "card": '{"colour": 1}'}, r"unknown ones \['colour'\]"),
        (lambda m: {**m, "card": '{"measures": {"a": "b"}}'}, "expected int or float"),
        (lambda m: {**m, "training_family": "[]"}, "is a list"),
        (lambda m: {k: v for k, v in m.items() if k != "pemirl_reward"}, "expected those of a re"),
        (lambda m: {**m, "pemirl_reward": m["pemirl_reward"].replace("[3]", "[9]")}, "not those"),
        (lambda m: {**m, "pemirl_reward": m["pemirl_reward"].replace("shaped", "gail")}, "damaged"),
    ],
)
def test_a_damaged_file_is_refused_by_name(file, change, message):
    rewritten(file, change)
    with pytest.raises(ValueError, match=message):
        load_reward(file)


def test_other_weights_are_refused(tmp_path):
    save_weights(tmp_path / "w", {"net": torch.nn.Linear(1, 1)}, {"task": "toy"})
    with pytest.raises(ValueError, match=r"/w holds weights \['task'\], expected those of a rew"):
        load_reward(tmp_path / "w")
    with pytest.raises(ValueError, match="/w has no card"):
        load_card(tmp_path / "w")


def test_a_card_as_a_page(file):
    page = CARD.markdown("toy")
    for line in ("license: mit", "| return | -1.5 |", "| training.iterations | 3 |"):
        assert f"{line}\n" in page
    assert json.loads(json.dumps(CARD.json())) == CARD.json()


def test_it_is_a_copy(file):
    model = trained()
    reward = PortableReward.of(model)
    before = reward(torch.ones(3), torch.ones(2))
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.add_(1.0)
    assert torch.equal(reward(torch.ones(3), torch.ones(2)), before)
