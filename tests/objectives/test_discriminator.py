"""The classification loss and its R1 penalty, by hand."""

import math

import pytest
import torch
from tensordict import TensorDict

from pemirl_trl.modules import AIRLDiscriminator, GAILDiscriminator, ShapedReward
from pemirl_trl.objectives import DiscriminatorLoss

from .problems import A, S, networks, rollouts

LN3 = math.log(3.0)


@pytest.fixture
def by_hand(float64):
    """r = 2 s and h = s with gamma = 1/2, on one transition of each kind, both with logit ln 3.

    Expert: s = 1, s' = 3, f = 2 + 3/2 - 1 = 5/2. Policy: s = -1, s' = 2, f = -2 + 1 + 1 = 0.
    """
    reward = ShapedReward(1, 1, gamma=0.5, hidden=())
    with torch.no_grad():
        for parameter in reward.parameters():
            parameter.zero_()
        reward.reward_net[0].weight[0, 0] = 2.0
        reward.potential_net[0].weight[0, 0] = 1.0
    batch = TensorDict(
        {
            "observation": torch.tensor([[1.0], [-1.0]]),
            "next": {"observation": torch.tensor([[3.0], [2.0]])},
            "context": torch.zeros(2, 1),
            "action_log_prob": torch.tensor([2.5 - LN3, -LN3]),
            "is_expert": torch.tensor([True, False]),
        },
        [2],
    )
    return reward, batch


def test_loss_and_metrics(by_hand):
    reward, batch = by_hand
    result = DiscriminatorLoss(AIRLDiscriminator(reward))(batch)
    # D = 3/4 on both: -log D = ln(4/3) and -log(1 - D) = ln 4.
    assert result["loss_discriminator"].item() == pytest.approx((math.log(4 / 3) + math.log(4)) / 2)
    assert result["accuracy"] == 0.5
    assert result["logit_expert_mean"].item() == pytest.approx(LN3)
    assert result["logit_policy_mean"].item() == pytest.approx(LN3)


def test_gradient(by_hand):
    reward, batch = by_hand
    DiscriminatorLoss(AIRLDiscriminator(reward))(batch)["loss_discriminator"].backward()
    # Mean of (D - is_expert) df/dw: df/dw is s for r, and s'/2 - s for h.
    expected = (-0.25 * 1 + 0.75 * -1) / 2, (-0.25 * 0.5 + 0.75 * 2) / 2
    for net, value in zip((reward.reward_net, reward.potential_net), expected, strict=True):
        assert net[0].weight.grad[0, 0].item() == pytest.approx(value)


def test_gail_by_hand(float64):
    """g = s + 2 a + b on one transition of each kind, both with logit ln 3."""
    discriminator = GAILDiscriminator(1, 1, hidden=())
    with torch.no_grad():
        discriminator.net[0].weight.copy_(torch.tensor([[1.0, 2.0]]))
        discriminator.net[0].bias.fill_(LN3)
    batch = TensorDict(
        {
            "observation": torch.tensor([[2.0], [-6.0]]),
            "action": torch.tensor([[-1.0], [3.0]]),
            "is_expert": torch.tensor([True, False]),
        },
        [2],
    )
    result = DiscriminatorLoss(discriminator)(batch)
    # D = 3/4 on both: -log D = ln(4/3) and -log(1 - D) = ln 4.
    assert result["loss_discriminator"].item() == pytest.approx((math.log(4 / 3) + math.log(4)) / 2)
    assert result["logit_expert_mean"].item() == pytest.approx(LN3)
    assert result["logit_policy_mean"].item() == pytest.approx(LN3)
    result["loss_discriminator"].backward()
    # Mean of (D - is_expert) (s, a): (-1/4 * 2 + 3/4 * -6) / 2 and (-1/4 * -1 + 3/4 * 3) / 2.
    assert discriminator.net[0].weight.grad.tolist() == [pytest.approx([-2.5, 1.25])]


def test_each_discriminator_reads_what_its_role_keys_say():
    nets = networks()
    airl, gail = DiscriminatorLoss(nets.discriminator), DiscriminatorLoss(nets.gail)
    following = ("next", "observation")
    assert airl.in_keys == ["observation", following, "context", "action_log_prob", "is_expert"]
    assert gail.in_keys == ["observation", "action", "is_expert"]
    for network in (nets.discriminator, nets.gail):
        assert DiscriminatorLoss(network).in_keys == [*network.in_keys, "is_expert"]


def test_gail_sees_neither_context_nor_density():
    nets, batch = networks(), rollouts()
    expected = DiscriminatorLoss(nets.gail)(batch)
    for key in ("context", "action_log_prob"):
        batch[key] = batch[key] + 100.0
    assert (DiscriminatorLoss(nets.gail)(batch) == expected).all()
    batch["action"] = batch["action"] + torch.ones(A)
    assert (DiscriminatorLoss(nets.gail)(batch) != expected).any()


def test_trailing_dimensions_of_flags_and_densities_do_not_matter(by_hand):
    reward, batch = by_hand
    loss = DiscriminatorLoss(AIRLDiscriminator(reward))
    expected = loss(batch)
    for key in ("is_expert", "action_log_prob"):
        batch[key] = batch[key].unsqueeze(-1)
    assert (loss(batch) == expected).all()


def penalty(nets, batch, coeff=0.3):
    loss = DiscriminatorLoss(nets.discriminator, gradient_penalty_coeff=coeff)
    return loss(batch)["loss_gradient_penalty"]


def test_the_penalty_is_the_squared_slope_in_standardised_observations(float64):
    nets, batch = networks(), rollouts()
    standard = nets.reward.standardize(batch["observation"]).flatten(0, 1)
    context, expert = batch["context"].flatten(0, 1), batch["is_expert"].flatten()
    slope = torch.func.grad(lambda x, m: nets.reward.reward_net(x, m).squeeze(-1))
    squared = torch.vmap(slope)(standard, context).square().sum(-1)
    expected = squared[expert].mean() + squared[~expert].mean()
    assert torch.isclose(penalty(nets, batch), 0.3 * expected)


def test_the_penalty_of_a_linear_reward_and_its_gradient_by_hand(float64):
    nets, batch = networks(), rollouts()
    scale = nets.reward.standardize.scale
    nets.reward.reward_net = torch.nn.Linear(S, 1)
    nets.reward.reward = lambda s, m: nets.reward.reward_net(s)  # of raw observations
    slope = nets.reward.reward_net.weight
    value = penalty(nets, batch)
    assert torch.isclose(value, 0.3 * 2 * (slope * scale).square().sum())
    (gradient,) = torch.autograd.grad(value, slope)
    assert torch.allclose(gradient, 0.3 * 4 * slope * scale**2)


def test_the_penalty_is_on_the_reward_alone_and_zero_without_gradients():
    nets, batch = networks(), rollouts()
    value = penalty(nets, batch)
    potential = list(nets.reward.potential_net.parameters())
    assert torch.autograd.grad(value, potential, allow_unused=True) == (None,) * len(potential)
    with torch.no_grad():
        assert penalty(nets, batch) == 0
    assert "loss_gradient_penalty" not in DiscriminatorLoss(nets.discriminator)(batch)


@pytest.mark.parametrize("detach", [True, False])
def test_only_an_attached_sample_carries_the_gradient_to_the_encoder(detach):
    nets, batch = networks(), rollouts()
    inputs = TensorDict({k: batch[k] for k in ("observation", "action")}, batch.shape[:1])
    sample = nets.encoder.get_dist(inputs).rsample().unsqueeze(1).expand_as(batch["context"])
    batch["context"] = sample
    loss = DiscriminatorLoss(nets.discriminator, detach_context=detach, gradient_penalty_coeff=0.1)
    sum(v for k, v in loss(batch).items() if k.startswith("loss_")).backward()
    reached = [p.grad is not None and p.grad.any().item() for p in nets.encoder.parameters()]
    assert all(reached) if not detach else not any(reached)
    assert all(p.grad is not None for p in nets.reward.parameters())


def test_no_gradient_reaches_the_density():
    nets, batch = networks(), rollouts()
    batch["action_log_prob"].requires_grad_()
    DiscriminatorLoss(nets.discriminator)(batch)["loss_discriminator"].backward()
    assert batch["action_log_prob"].grad is None
