"""The inference models: what they read, what they ignore, what they return."""

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from torchrl.envs.utils import ExplorationType, set_exploration_type

from pemirl_trl.data import DemonstrationDataset
from pemirl_trl.modules import (
    AttentionContextEncoder,
    ContextEncoder,
    ContextPolicy,
    MaskedContextEncoder,
    NoContext,
    ShapedReward,
)
from pemirl_trl.modules.attention_encoder import places

N, T, S, A, D = 5, 6, 3, 2, 2


def trajectories(horizon=T):
    return TensorDict(
        {"observation": torch.randn(N, horizon, S), "action": torch.randn(N, horizon, A)}, [N]
    )


any_length = pytest.mark.parametrize("kind", [MaskedContextEncoder, AttentionContextEncoder])


@pytest.fixture(params=[ContextEncoder, MaskedContextEncoder, AttentionContextEncoder])
def encoder(request):
    horizon = (T,) if request.param is ContextEncoder else ()
    return request.param(S, A, D, *horizon, scale_depends_on_input=True)


def test_get_dist_is_a_diagonal_gaussian_and_leaves_its_input_unchanged(encoder):
    batch = trajectories()
    before = batch.clone()
    q = encoder.get_dist(batch)
    assert set(batch.keys()) == set(before.keys())
    assert (batch == before).all()
    assert (q.batch_shape, q.event_shape) == ((N,), (D,))
    m = torch.randn(N, D)
    expected = torch.distributions.Normal(q.mean, q.stddev).log_prob(m).sum(-1)
    assert torch.allclose(q.log_prob(m), expected)
    assert encoder.context_dim == D


def test_the_module_writes_the_mean_or_a_sample(encoder):
    batch = trajectories()
    q = encoder.get_dist(batch)
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        result = encoder(batch.copy())
    assert torch.equal(result["context"], q.mean)
    assert torch.equal(result["context_loc"], q.mean)
    assert torch.equal(result["context_scale"], q.stddev)
    with set_exploration_type(ExplorationType.RANDOM):
        draws = torch.stack([encoder(batch.copy())["context"] for _ in range(300)])
    standard = (draws - q.mean) / q.stddev
    assert standard.mean().abs() < 0.1
    assert abs(standard.std() - 1) < 0.1


def test_a_sample_is_reparameterised(encoder):
    encoder.get_dist(trajectories()).rsample().square().sum().backward()
    assert all(p.grad is not None and p.grad.any() for p in encoder.parameters())


def test_trajectories_do_not_see_each_other(encoder, float64):
    encoder = encoder.double()
    batch = trajectories()
    order = torch.tensor([3, 0, 4, 1, 2])
    expected = encoder.get_dist(batch).mean[order]
    assert torch.allclose(encoder.get_dist(batch[order]).mean, expected)


def test_every_step_matters_and_only_the_average_does_not_see_their_order(encoder):
    batch = trajectories()
    mean = encoder.get_dist(batch).mean
    for t in range(T):
        other = batch.clone()
        other["action"][:, t] += 1.0
        assert (encoder.get_dist(other).mean - mean).abs().min() > 1e-6
    reverse = batch.apply(lambda x: x.flip(1))
    same = torch.allclose(encoder.get_dist(reverse).mean, mean, atol=1e-6)
    assert same == isinstance(encoder, MaskedContextEncoder)


def test_one_deviation_for_all_unless_told():
    shared = ContextEncoder(S, A, D, T, initial_scale=0.3)
    assert torch.allclose(shared.get_dist(trajectories()).stddev, torch.tensor(0.3))
    own = ContextEncoder(S, A, D, T, initial_scale=0.3, scale_depends_on_input=True)
    deviation = own.get_dist(trajectories()).stddev
    assert deviation.std(0).min() > 0
    assert (deviation > 0).all()


@pytest.mark.parametrize("horizon", [T - 1, T + 1])
def test_another_horizon_is_refused(horizon):
    with pytest.raises(ValueError, match=f"exactly 6 steps, got {horizon}.*MaskedContextEncoder"):
        ContextEncoder(S, A, D, T).get_dist(trajectories(horizon))


def padded(fill):
    """Trajectories of 6, 5, 4, 3 and 2 valid steps; the rest is padding."""
    batch = trajectories()
    lengths = torch.tensor([6, 5, 4, 3, 2])
    mask = torch.arange(T) < lengths.unsqueeze(-1)
    for key in ("observation", "action"):
        batch[key][~mask] = fill
    return batch.set("mask", mask), lengths


@pytest.mark.parametrize("fill", [1e6, torch.nan, torch.inf])
@any_length
def test_padding_changes_nothing(kind, fill):
    encoder = kind(S, A, D, scale_depends_on_input=True)
    batch, lengths = padded(fill)
    q = encoder.get_dist(batch)
    for i, length in enumerate(lengths):
        cut = {key: batch[key][i : i + 1, :length] for key in ("observation", "action")}
        alone = encoder.get_dist(TensorDict(cut, [1]))
        assert torch.allclose(q.mean[i], alone.mean[0], atol=1e-6)
        assert torch.allclose(q.stddev[i], alone.stddev[0], atol=1e-6)


@any_length
def test_padding_leaves_gradients_finite_and_equal(kind):
    encoder = kind(S, A, D, activation=nn.Tanh)
    torch.manual_seed(1)
    zeros, _ = padded(0.0)
    torch.manual_seed(1)
    nans, _ = padded(torch.nan)
    gradients = [
        torch.autograd.grad(
            encoder.get_dist(b).log_prob(torch.ones(N, D)).sum(), encoder.parameters()
        )
        for b in (zeros, nans)
    ]
    for expected, got in zip(*gradients, strict=True):
        assert torch.equal(got, expected)


@any_length
def test_a_trajectory_without_a_valid_step_is_refused(kind):
    batch, _ = padded(0.0)
    batch["mask"][2] = False
    with pytest.raises(ValueError, match="no valid step"):
        kind(S, A, D).get_dist(batch)


def test_the_flat_encoder_refuses_padding():
    batch, _ = padded(0.0)
    with pytest.raises(ValueError, match="all 6 steps of a trajectory, and 4 of these have paddi"):
        ContextEncoder(S, A, D, T).get_dist(batch)
    batch["mask"][:] = True
    without = ContextEncoder(S, A, D, T)
    assert torch.equal(without.get_dist(batch).mean, without.get_dist(batch.exclude("mask")).mean)


def test_where_a_step_is_does_not_depend_on_padding():
    mask = torch.tensor([[True] * 4, [True, True, False, False]])
    share, start, end = places(mask).unbind(-1)
    assert share[0].tolist() == [0.125, 0.375, 0.625, 0.875]
    assert share[1, :2].tolist() == [0.25, 0.75]
    assert start[0].tolist() == pytest.approx([1, 1 / 2, 1 / 3, 1 / 4])
    assert end[0].tolist() == pytest.approx([1 / 4, 1 / 3, 1 / 2, 1])
    assert end[1, :2].tolist() == [0.5, 1.0]


def test_attention_finds_what_an_average_blurs(float64):
    """The last position of a walk, among 49 others, at any length."""
    torch.manual_seed(0)
    errors = {}
    for kind in (MaskedContextEncoder, AttentionContextEncoder):
        torch.manual_seed(0)
        encoder = kind(1, 1, 1, hidden=(32, 32))
        optimizer = torch.optim.Adam(encoder.parameters(), 3e-3)
        for step in range(201):
            walk = 0.3 * torch.randn(64, 50, 1).cumsum(1)
            length = torch.randint(5, 51, (64, 1))
            batch = {"observation": walk, "action": torch.zeros(64, 50, 1)}
            batch["mask"] = torch.arange(50) < length
            last = walk.gather(1, length.unsqueeze(-1) - 1).squeeze(1)
            loss = (encoder.get_dist(TensorDict(batch, [64])).mean - last).square().mean()
            if step < 200:
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
        errors[kind] = float(loss.detach())
    assert errors[AttentionContextEncoder] < 0.25 * errors[MaskedContextEncoder]


def test_no_context_is_certain_and_has_nothing_to_learn():
    encoder, batch = NoContext(), trajectories()
    q = encoder.get_dist(batch)
    assert (q.batch_shape, q.event_shape) == ((N,), (0,))
    assert q.rsample().shape == q.mean.shape == (N, 0)
    assert torch.equal(q.log_prob(q.rsample()), torch.zeros(N))
    assert encoder(batch)["context"].shape == (N, 0)
    assert encoder.context_dim == 0
    assert list(encoder.parameters()) == []


def test_policy_and_reward_without_context_are_functions_of_the_state(float64):
    steps = {"observation": torch.randn(N, T, S), "next": {"observation": torch.randn(N, T, S)}}
    batch = TensorDict(steps, [N])
    batch["context"] = NoContext().get_dist(batch).mean.unsqueeze(1).expand(N, T, 0)
    policy, reward = ContextPolicy(S, A, 0), ShapedReward(S, 0, gamma=0.5)
    assert torch.equal(policy.get_dist(batch).mean, policy.gaussian.net(batch["observation"]))
    s, following = batch["observation"], batch["next", "observation"]
    shaping = 0.5 * reward.potential_net(following) - reward.potential_net(s)
    assert torch.allclose(reward(batch)["shaped_reward"], reward.reward_net(s) + shaping)


def test_a_data_set_is_taken_for_its_trajectories(encoder):
    dataset = DemonstrationDataset(torch.randn(N, T + 1, S), torch.randn(N, T, A))
    expected = encoder.get_dist(dataset.trajectories())
    got = encoder.get_dist(dataset)
    assert torch.equal(got.mean, expected.mean)
    assert torch.equal(got.stddev, expected.stddev)
    assert torch.equal(encoder(dataset)["context_loc"], expected.mean)


@pytest.mark.parametrize("model", [ContextEncoder(S, A, D, T), MaskedContextEncoder(S, A, D)])
@pytest.mark.parametrize(
    "spoil", [lambda batch: batch.auto_batch_size_(2), lambda batch: batch.auto_batch_size_(2)[0]]
)
def test_a_batch_whose_size_counts_steps_is_refused(model, spoil):
    batch = spoil(trajectories())
    message = rf"{type(model).__name__} reduces time: it takes trajectories of batch size \[N\]"
    for call in (model, model.get_dist):
        with pytest.raises(ValueError, match=message):
            call(batch)


def test_without_contexts_too_a_flat_batch_is_refused():
    flat = trajectories().auto_batch_size_(2).reshape(-1)
    with pytest.raises(ValueError, match=r"NoContext reduces time.*got batch size \[30\]"):
        NoContext().get_dist(flat)
