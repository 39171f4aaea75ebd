"""What TorchRL's users expect of a loss, for every loss of the library."""

import copy
import dataclasses
from types import SimpleNamespace

import pytest
import torch

from pemirl_trl import objectives
from pemirl_trl.modules import (
    AIRLDiscriminator,
    ContextEncoder,
    ContextPolicy,
    ContextValue,
    GAILDiscriminator,
    ShapedReward,
)
from pemirl_trl.modules.reading import MissingKeyError
from pemirl_trl.objectives import DiscriminatorLoss, InfoLoss, MetaILLoss, TRPOLoss, ValueLoss
from pemirl_trl.objectives.common import KeyedLoss

from .problems import A, D, K, S, T, networks, rollouts

BUILD = {
    "discriminator": lambda n: DiscriminatorLoss(n.discriminator, gradient_penalty_coeff=0.1),
    "gail": lambda n: DiscriminatorLoss(n.gail, gradient_penalty_coeff=0.1),
    "info": lambda n: InfoLoss(n.encoder, n.reward, rollouts_per_context=K),
    "meta_il": lambda n: MetaILLoss(n.encoder, n.policy),
    "trpo": lambda n: TRPOLoss(n.policy, entropy_coeff=0.1),
    "value": lambda n: ValueLoss(n.value),
}
# Which networks each differentiable output trains: no other may receive a gradient.
TRAINS = {
    ("discriminator", "loss_discriminator"): {"reward"},
    ("discriminator", "loss_gradient_penalty"): {"reward"},
    ("gail", "loss_discriminator"): {"gail"},
    ("gail", "loss_gradient_penalty"): {"gail"},
    ("info", "loss_info_encoder"): {"encoder"},
    ("info", "loss_info_reward"): {"reward"},
    ("meta_il", "loss_imitation"): {"encoder", "policy"},
    ("meta_il", "loss_kl"): {"encoder"},
    ("trpo", "loss_objective"): {"policy"},
    ("trpo", "kl"): {"policy"},
    ("value", "loss_value"): {"value"},
}
NETWORKS = sorted(set().union(*TRAINS.values()))


def keys_read(name):
    """The accepted keys that this build of a loss reads: which, is its networks' business."""
    loss = BUILD[name](networks())
    accepted = [field.name for field in dataclasses.fields(loss._AcceptedKeys)]
    return [key for key in accepted if getattr(loss.tensor_keys, key) in loss.in_keys]


KEYS = [(name, key) for name in BUILD for key in keys_read(name)]

each_loss = pytest.mark.parametrize("name", BUILD)


def values(loss, *args, **kwargs):
    """Outputs by name; Meta-IL draws, so every call starts from one seed."""
    torch.manual_seed(0)
    result = loss(*args, **kwargs)
    if not kwargs:
        return dict(result.items())
    result = result if isinstance(result, tuple) else (result,)
    return dict(zip(loss.out_keys, result, strict=True))


def assert_same(first, second):
    assert first.keys() == second.keys()
    for key, value in first.items():
        assert torch.allclose(value, second[key]), key


def test_the_table_lists_every_loss():
    exported = {getattr(objectives, name) for name in objectives.__all__}
    losses = {cls for cls in exported if issubclass(cls, KeyedLoss)}
    assert losses == {type(build(networks())) for build in BUILD.values()}


@each_loss
def test_outputs_are_those_announced_and_only_losses_carry_a_gradient(name):
    loss = BUILD[name](networks())
    result = values(loss, rollouts())
    assert set(result) == set(loss.out_keys)
    differentiable = {key for key, value in result.items() if value.requires_grad}
    assert differentiable == {key for owner, key in TRAINS if owner == name}
    assert all(value.isfinite() for value in result.values())


@pytest.mark.parametrize(("name", "key"), TRAINS)
def test_gradients_reach_exactly_the_networks_that_the_loss_trains(name, key):
    nets = networks()
    loss, batch = BUILD[name](nets), rollouts()
    loss(batch)[key].backward()
    trained = {
        network
        for network in NETWORKS
        if any(
            p.grad is not None and p.grad.abs().sum() > 0
            for p in getattr(nets, network).parameters()
        )
    }
    assert trained == TRAINS[name, key]


@each_loss
def test_the_input_stays_unchanged(name):
    batch = rollouts()
    before = batch.clone()
    values(BUILD[name](networks()), batch)
    assert set(batch.keys(True)) == set(before.keys(True))
    assert (batch == before).all()


@each_loss
def test_an_unknown_key_is_refused(name):
    with pytest.raises(ValueError, match="not_a_key is not an accepted tensordict key"):
        BUILD[name](networks()).set_keys(not_a_key="x")


@pytest.mark.parametrize(("name", "key"), KEYS)
def test_a_key_can_be_renamed(name, key):
    loss, batch = BUILD[name](networks()), rollouts()
    expected = values(loss, batch)
    default = getattr(loss.tensor_keys, key)
    batch.rename_key_(default, ("elsewhere", key))
    with pytest.raises(KeyError):
        values(loss, batch)
    loss.set_keys(**{key: ("elsewhere", key)})
    assert ("elsewhere", key) in loss.in_keys
    assert default not in loss.in_keys
    assert_same(values(loss, batch), expected)


@each_loss
def test_a_call_by_keywords_is_the_call_on_a_tensordict(name):
    loss, batch = BUILD[name](networks()), rollouts()
    inputs = {k if isinstance(k, str) else "_".join(k): batch[k] for k in loss.in_keys}
    assert_same(values(loss, **inputs), values(loss, batch))


@each_loss
def test_outputs_can_be_selected(name):
    loss, batch = BUILD[name](networks()), rollouts()
    first, *others = loss.out_keys
    loss.select_out_keys(first)
    result = values(loss, batch)
    assert first in result
    assert not set(others) & set(result)


@each_loss
def test_state_moves_to_another_loss(name):
    source, target, batch = BUILD[name](networks()), BUILD[name](networks()), rollouts()
    expected, other = values(source, batch), values(target, batch)
    assert any(not torch.allclose(expected[key], other[key]) for key in expected)
    target.load_state_dict(source.state_dict())
    assert_same(values(target, batch), expected)


@each_loss
def test_a_deep_copy_is_independent(name):
    loss, batch = BUILD[name](networks()), rollouts()
    expected = values(loss, batch)
    twin = copy.deepcopy(loss)
    assert_same(values(twin, batch), expected)
    with torch.no_grad():
        for parameter in twin.parameters():
            parameter.add_(0.5)
    assert_same(values(loss, batch), expected)
    moved = values(twin, batch)
    assert any(not torch.allclose(moved[key], expected[key]) for key in expected)


@each_loss
def test_the_loss_holds_the_live_parameters(name):
    nets = networks()
    loss = BUILD[name](nets)
    live = {p.data_ptr() for n in vars(nets).values() for p in n.parameters()}
    assert {p.data_ptr() for p in loss.parameters()} <= live


@pytest.mark.parametrize(
    ("build", "key"),
    [
        (lambda n, r: DiscriminatorLoss(n.discriminator, reduction=r), "loss_discriminator"),
        (lambda n, r: DiscriminatorLoss(n.gail, reduction=r), "loss_discriminator"),
        (lambda n, r: TRPOLoss(n.policy, reduction=r), "loss_objective"),
        (lambda n, r: ValueLoss(n.value, reduction=r), "loss_value"),
    ],
)
def test_reductions(build, key):
    nets, batch = networks(), rollouts()
    each = build(nets, "none")(batch)[key]
    assert each.shape[:2] == batch.shape
    assert torch.allclose(build(nets, "mean")(batch)[key], each.mean())
    assert torch.allclose(build(nets, "sum")(batch)[key], each.sum())


@pytest.mark.parametrize(("name", "key"), KEYS)
def test_a_missing_key_is_named_with_the_loss_that_reads_it(name, key):
    loss, batch = BUILD[name](networks()), rollouts()
    absent = getattr(loss.tensor_keys, key)
    with pytest.raises(MissingKeyError, match=f"^{type(loss).__name__} reads .*batch lacks; it h"):
        loss(batch.exclude(absent))


@pytest.mark.parametrize("name", ["discriminator", "info", "trpo", "value"])
def test_who_reads_a_context_says_who_writes_it(name):
    with pytest.raises(MissingKeyError, match=r"'context'.*InferContext writes it at reset"):
        BUILD[name](networks())(rollouts().exclude("context"))


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda n: DiscriminatorLoss(n.reward), r"ShapedReward: wrap it, AIRLDiscriminator\("),
        (lambda n: DiscriminatorLoss(n.policy), "takes a discriminator .*got ContextPolicy"),
        (lambda n: InfoLoss(n.reward, n.encoder, rollouts_per_context=K), "takes an encoder"),
        (
            lambda n: InfoLoss(n.encoder, n.discriminator, rollouts_per_context=K),
            r"takes a shaped reward .*AIRLDiscriminator: pass its \.reward",
        ),
        (lambda n: InfoLoss(n.encoder, n.gail, rollouts_per_context=K), "GAILDiscriminator$"),
        (lambda n: MetaILLoss(n.policy, n.encoder), "takes an encoder .*got ContextPolicy"),
        (lambda n: MetaILLoss(n.encoder, n.encoder), "takes a policy .*got ContextEncoder"),
        (lambda n: TRPOLoss(n.encoder), "takes a policy .*got ContextEncoder"),
    ],
)
def test_a_part_in_the_place_of_another_is_refused(build, message):
    with pytest.raises(TypeError, match=message):
        build(networks())


@each_loss
def test_a_flat_batch_is_the_same_batch_or_is_refused(name):
    loss, batch = BUILD[name](networks()), rollouts()
    if name in ("discriminator", "gail", "trpo"):  # these are about single transitions
        assert_same(values(loss, batch.reshape(-1)), values(loss, batch))
    else:
        with pytest.raises(ValueError, match=r"got observations? \[24, 3\].*flat"):
            loss(batch.reshape(-1))


@each_loss
def test_float64_networks_take_float32_data(name, float64):
    loss, batch = BUILD[name](networks()), rollouts()
    result = values(loss, batch.float())
    assert {value.dtype for value in result.values()} == {torch.float64}
    for key, value in values(loss, batch).items():
        assert torch.allclose(result[key], value, rtol=1e-4, atol=1e-5), key


def renamed_networks():
    """Networks whose keys are all their own."""
    reward = ShapedReward(S, D, context_key="m")
    discriminator = AIRLDiscriminator(reward, log_prob_key="log_pi")
    policy = ContextPolicy(S, A, D, context_key="m", log_prob_key="log_pi")
    return SimpleNamespace(
        encoder=ContextEncoder(S, A, D, T, context_key="m"),
        reward=reward,
        discriminator=discriminator,
        gail=GAILDiscriminator(S, A),
        policy=policy,
        value=ContextValue(S, D, T, context_key="m", value_key="v"),
    )


@each_loss
def test_a_loss_follows_the_keys_of_its_networks(name):
    loss, batch = BUILD[name](renamed_networks()), rollouts()
    batch.rename_key_("context", "m").rename_key_("action_log_prob", "log_pi")
    assert all(value.isfinite() for value in values(loss, batch).values())
