"""Meta-IL's bound: m is drawn once per trajectory, and the expectation is the analytic one."""

import math

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch.distributions import Normal, kl_divergence
from torchrl.modules import ProbabilisticActor

from pemirl_trl.data import DemonstrationDataset
from pemirl_trl.modules import ContextEncoder, ContextPolicy
from pemirl_trl.modules.context_encoder import diagonal_normal
from pemirl_trl.objectives import MetaILLoss

from .problems import A, D, N, S, T, networks, rollouts


def test_the_expected_loss_is_the_analytic_one(float64):
    """Of a linear policy: a Gaussian m adds its variance, seen through the policy's weights."""
    draws = 4000
    encoder = networks().encoder
    policy = ContextPolicy(S, A, D, hidden=(), initial_scale=0.7)
    demonstration = rollouts()[:1].select("observation", "action")
    batch = demonstration.expand(draws, T).contiguous()
    loss = MetaILLoss(encoder, policy)(batch)["loss_imitation"]

    demonstration.batch_size = [1]
    q = encoder.get_dist(demonstration)
    mean = policy.gaussian.net(
        demonstration["observation"], q.mean.unsqueeze(1).expand(-1, T, -1)
    )  # [1, T, A]
    weight = policy.gaussian.net[0].weight[:, S:]  # [A, D]
    spread = (weight.square() * q.variance).sum(-1)  # [A]
    squared = (demonstration["action"] - mean).square() + spread
    expected = 0.5 * (squared / 0.7**2 + math.log(2 * math.pi * 0.7**2)).sum(-1).mean()
    at_the_mean = expected - 0.5 * (spread / 0.7**2).sum()
    assert abs(loss - expected) < 0.2 * abs(at_the_mean - expected)


def test_one_draw_per_trajectory_and_a_new_one_per_call():
    """pi(a | s, m) = N(m, 1), q = N(0, 1), a = 0: the loss is m^2 / 2 + const, of variance 1/2.

    The mean of q would give no variance, a draw per step a fourth of it.
    """
    encoder, policy = ContextEncoder(S, 1, 1, T, hidden=()), ContextPolicy(S, 1, 1, hidden=())
    with torch.no_grad():
        for parameter in (*encoder.parameters(), *policy.parameters()):
            parameter.zero_()
        policy.gaussian.net[0].weight[0, S] = 1.0
    batch = rollouts()[:1].select("observation").set("action", torch.zeros(1, T, 1))
    loss = MetaILLoss(encoder, policy)
    losses = torch.stack([loss(batch)["loss_imitation"].detach() for _ in range(250)])
    assert 0.3 < losses.var() < 0.8


def test_the_kl_is_torchs(float64):
    nets, batch = networks(), rollouts()
    result = MetaILLoss(nets.encoder, nets.policy, kl_coeff=0.25)(batch)
    batch.batch_size = batch.shape[:1]
    q = nets.encoder.get_dist(batch)
    expected = kl_divergence(Normal(q.mean, q.stddev), Normal(0.0, 1.0)).sum(-1).mean()
    assert torch.isclose(result["kl"], expected)
    assert torch.isclose(result["loss_kl"], 0.25 * expected)


def test_a_data_set_is_taken_for_its_trajectories():
    nets = networks()
    dataset = DemonstrationDataset(torch.randn(N, T + 1, S), torch.randn(N, T, A))
    results = []
    for demonstrations in (dataset, dataset.trajectories()):
        torch.manual_seed(1)
        results.append(MetaILLoss(nets.encoder, nets.policy)(demonstrations))
    assert (results[0] == results[1]).all()


def test_the_policy_says_where_it_reads_the_context():
    """Whatever the order of its keys."""
    nets, batch = networks(), rollouts()
    swapped = ProbabilisticActor(
        TensorDictModule(
            lambda m, s: nets.policy.gaussian(s, m), ["m", "observation"], ["loc", "scale"]
        ),
        in_keys=["loc", "scale"],
        distribution_class=diagonal_normal,
    )
    swapped.context_key = "m"
    results = []
    for policy in (nets.policy, swapped):
        torch.manual_seed(1)
        results.append(MetaILLoss(nets.encoder, policy)(batch))
    assert torch.equal(results[0]["loss_imitation"], results[1]["loss_imitation"])


def test_a_policy_without_contexts_is_refused():
    policy = ProbabilisticActor(
        TensorDictModule(torch.nn.Linear(S, A), ["observation"], ["loc"]),
        in_keys=["loc"],
        distribution_class=torch.distributions.Normal,
        distribution_kwargs={"scale": 1.0},
    )
    with pytest.raises(ValueError, match=r"reads \['observation'\].*known to be the context"):
        MetaILLoss(networks().encoder, policy)


def test_m_is_of_what_is_shown_and_the_actions_are_the_demonstrations_own():
    model, batch = networks(), rollouts().select("observation", "action")
    batch.batch_size = batch.batch_size[:1]
    other = batch.apply(torch.neg)
    loss = MetaILLoss(model.encoder, model.policy)
    torch.manual_seed(0)
    losses = loss(batch.clone().set("shown", other))
    torch.manual_seed(0)
    q = model.encoder.get_dist(other)
    m = q.rsample().unsqueeze(1).expand(-1, T, -1)
    inputs = TensorDict({"observation": batch["observation"], "context": m}, [len(batch), T])
    expected = -model.policy.get_dist(inputs).log_prob(batch["action"]).mean()
    assert torch.allclose(losses["loss_imitation"], expected)
    prior = Normal(torch.zeros(D), torch.ones(D))
    assert torch.allclose(
        losses["kl"], kl_divergence(Normal(q.mean, q.stddev), prior).sum(-1).mean()
    )
