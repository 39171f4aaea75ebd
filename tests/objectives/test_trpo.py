"""Surrogate, constraint and natural gradient of the Gaussian policy, against closed forms."""

import math

import pytest
import torch
from tensordict.nn import TensorDictModule
from torch.nn.utils import parameters_to_vector
from torchrl.modules import NormalParamExtractor, ProbabilisticActor, TanhNormal

from pemirl_trl.objectives import TRPOLoss
from pemirl_trl.objectives.trpo import _kl
from pemirl_trl.optim import TrustRegionOptimizer

from .problems import A, S, networks, rollouts


@pytest.fixture
def problem(float64):
    """A policy, and rollouts that it has drawn itself."""
    policy, batch = networks().policy, rollouts()
    with torch.no_grad():
        policy.log_scale.copy_(torch.tensor([0.3, -0.4]))
        policy(batch)
        batch["action"] = policy.get_dist(batch).sample()
        batch["action_log_prob"] = policy.get_dist(batch).log_prob(batch["action"])
    return policy, batch


def nudge(policy, size=0.1):
    with torch.no_grad():
        for parameter in policy.parameters():
            parameter.add_(size * torch.randn_like(parameter))


def test_the_kl_before_a_step_is_exactly_zero():
    policy, batch = networks().policy, rollouts()
    with torch.no_grad():
        policy(batch)
    assert TRPOLoss(policy)(batch)["kl"] == 0


def test_the_kl_is_that_of_old_to_new(problem):
    policy, batch = problem
    nudge(policy)
    new = policy.get_dist(batch.copy())
    old_loc, old_scale = batch["loc"], batch["scale"]
    per_action = (
        (new.stddev / old_scale).log()
        + (old_scale.square() + (old_loc - new.mean).square()) / (2 * new.variance)
        - 0.5
    )
    got = TRPOLoss(policy)(batch)["kl"]
    assert torch.isclose(got, per_action.sum(-1).mean())
    actions = old_loc + old_scale * torch.randn(20_000, *old_loc.shape)
    old = torch.distributions.Normal(old_loc, old_scale).log_prob(actions).sum(-1)
    ratios = (old - new.log_prob(actions)).mean((1, 2)).detach()
    assert (ratios.mean() - got).abs() < 4 * ratios.std() / math.sqrt(len(ratios))


def test_the_objective_is_the_weighted_advantage_plus_entropy(problem):
    policy, batch = problem
    nudge(policy)
    new = policy.get_dist(batch.copy())
    ratio = (new.log_prob(batch["action"]) - batch["action_log_prob"]).exp()
    entropy = (0.5 * (2 * math.pi * math.e * new.variance).log()).sum(-1).mean()
    expected = -(ratio * batch["advantage"].squeeze(-1)).mean()
    assert torch.isclose(TRPOLoss(policy)(batch)["loss_objective"], expected)
    result = TRPOLoss(policy, entropy_coeff=0.3)(batch)
    assert torch.isclose(result["loss_objective"], expected - 0.3 * entropy)
    assert torch.isclose(result["entropy"], entropy)


def test_the_gradient_is_the_policy_gradient_and_the_finite_difference(problem):
    policy, batch = problem
    parameters = list(policy.parameters())
    loss = TRPOLoss(policy)
    gradient = torch.autograd.grad(loss(batch)["loss_objective"], parameters)
    log_prob = policy.get_dist(batch.copy()).log_prob(batch["action"])
    score = torch.autograd.grad(-(log_prob * batch["advantage"].squeeze(-1)).mean(), parameters)
    for parameter, got, expected in zip(parameters, gradient, score, strict=True):
        assert torch.allclose(got, expected)
        flat, eps = parameter.detach().view(-1), 1e-6
        for i in range(0, len(flat), 7):
            values = []
            for sign in (1, -1):
                flat[i] += sign * eps
                values.append(loss(batch)["loss_objective"].item())
                flat[i] -= sign * eps
            difference = (values[0] - values[1]) / (2 * eps)
            assert got.view(-1)[i].item() == pytest.approx(difference, abs=1e-7)


def dense_fisher(policy, batch):
    """E[J' Sigma^-1 J] of the mean and 2 for each log deviation, in the policy's order."""
    names, tensors = zip(*policy.gaussian.named_parameters(), strict=True)
    rows = batch.select("observation", "context").reshape(-1)

    def mean(*values):
        loc, _ = torch.func.functional_call(
            policy.gaussian,
            dict(zip(names, values, strict=True)),
            (rows["observation"], rows["context"]),
        )
        return loc / policy.log_scale.detach().exp()

    jacobians = torch.autograd.functional.jacobian(mean, tensors)
    flat = torch.cat([j.flatten(2) for j in jacobians], -1)  # [rows, A, P]
    fisher = torch.einsum("nap,naq->pq", flat, flat) / len(rows)
    place = torch.cat([torch.full((p.numel(),), float(p is policy.log_scale)) for p in tensors])
    return fisher + 2 * torch.diag(place)


def test_the_step_is_that_of_a_dense_fisher_solve(problem):
    policy, batch = problem
    damping, max_kl = 1e-2, 1e-6  # so small that the models of loss and KL are exact
    parameters = list(policy.parameters())
    old = parameters_to_vector(parameters).detach().clone()
    loss = TRPOLoss(policy)
    gradient = torch.autograd.grad(loss(batch)["loss_objective"], parameters)
    gradient = torch.cat([g.flatten() for g in gradient])
    fisher = dense_fisher(policy, batch) + damping * torch.eye(len(old))
    direction = torch.linalg.solve(fisher, -gradient)
    expected = direction * (2 * max_kl / (direction @ fisher @ direction)).sqrt()

    def closure():
        losses = loss(batch)
        return losses["loss_objective"], losses["kl"]

    optimizer = TrustRegionOptimizer(
        parameters, max_kl=max_kl, damping=damping, cg_iterations=len(old)
    )
    result = optimizer.step(closure)
    step = parameters_to_vector(parameters).detach() - old
    assert result.accepted
    assert result.backtracks == 0
    assert (step - expected).norm() < 1e-4 * expected.norm()
    undamped = fisher - damping * torch.eye(len(old))
    assert result.kl == pytest.approx((0.5 * expected @ undamped @ expected).item(), rel=1e-2)
    assert policy.log_scale.shape == (A,)


def test_an_accepted_step_obeys_the_bound(problem):
    policy, batch = problem
    loss = TRPOLoss(policy)

    def closure():
        losses = loss(batch)
        return losses["loss_objective"], losses["kl"]

    before = loss(batch)["loss_objective"].item()
    result = TrustRegionOptimizer(policy.parameters(), max_kl=0.05).step(closure)
    after = loss(batch)
    assert result.accepted
    assert 0.01 < after["kl"].item() <= 0.05
    assert result.kl == pytest.approx(after["kl"].item())
    assert result.improvement == pytest.approx(before - after["loss_objective"].item())
    assert result.improvement > 0


def test_stored_densities_are_data_even_where_they_carry_gradients(problem):
    policy, batch = problem
    with torch.no_grad():
        expected = TRPOLoss(policy)(batch)
    attached = batch.copy().set("advantage", batch["advantage"].clone().requires_grad_())
    fresh = policy.get_dist(batch.copy())
    attached.update({"loc": fresh.mean, "scale": fresh.stddev})
    attached.set("action_log_prob", fresh.log_prob(batch["action"]))
    assert attached["action_log_prob"].requires_grad
    result = TRPOLoss(policy)(attached)
    for key, value in expected.items():
        assert torch.allclose(result[key], value, atol=1e-12), key

    def gradient(batch):
        loss = TRPOLoss(policy)(batch)["loss_objective"]
        return torch.autograd.grad(loss, list(policy.parameters()))

    for got, value in zip(gradient(attached), gradient(batch), strict=True):
        assert torch.allclose(got, value)
    result["loss_objective"].backward()
    assert attached["advantage"].grad is None


def squashed(event_dims=1, **bounds):
    """A policy of TorchRL's: a Gaussian, then tanh onto the range of the actions."""
    net = torch.nn.Sequential(torch.nn.Linear(S, 2 * A), NormalParamExtractor())
    return ProbabilisticActor(
        TensorDictModule(net, ["observation"], ["loc", "scale"]),
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        distribution_kwargs=bounds,
        return_log_prob=True,
    )


@pytest.fixture(params=[{}, {"low": -2.0, "high": 3.0}])
def squashed_problem(request, float64):
    policy, batch = squashed(**request.param), rollouts()
    with torch.no_grad():
        policy(batch)
        batch["action"] = policy.get_dist(batch).sample()
        batch["action_log_prob"] = policy.get_dist(batch).log_prob(batch["action"])
    return policy, batch


def test_the_kl_of_tanh_gaussians_is_that_of_their_gaussians(squashed_problem):
    policy, batch = squashed_problem
    assert TRPOLoss(policy)(batch)["kl"] == 0
    nudge(policy)
    new = policy.module[0](batch.select("observation"))
    old = torch.distributions.Normal(batch["loc"], batch["scale"])
    normal = torch.distributions.Normal(new["loc"], new["scale"])
    expected = torch.distributions.kl_divergence(old, normal).sum(-1)
    assert torch.isclose(TRPOLoss(policy)(batch)["kl"], expected.mean())
    # By samples of the squashed actions: the bijection cancels.
    before, after = policy.build_dist_from_params(batch), policy.get_dist(batch.copy())
    actions = before.sample((20_000,))
    ratios = (before.log_prob(actions) - after.log_prob(actions)).mean((1, 2)).detach()
    assert (ratios.mean() - expected.mean()).abs() < 4 * ratios.std() / math.sqrt(len(ratios))


def test_a_step_of_a_tanh_gaussian_policy_obeys_the_bound(squashed_problem):
    policy, batch = squashed_problem
    loss = TRPOLoss(policy)
    assert loss.out_keys == ["loss_objective", "kl"]  # its entropy has no closed form

    def closure():
        losses = loss(batch)
        return losses["loss_objective"], losses["kl"]

    result = TrustRegionOptimizer(policy.parameters(), max_kl=0.02).step(closure)
    assert result.accepted
    assert 0 < result.kl <= 0.02


def test_entropy_that_no_formula_gives_is_refused_at_once():
    with pytest.raises(ValueError, match=r"0\.1, but TanhNormal has no entropy in closed form"):
        TRPOLoss(squashed(), entropy_coeff=0.1)


def test_ranges_of_actions_that_differ_have_no_common_bijection(squashed_problem):
    policy, batch = squashed_problem
    new = policy.get_dist(batch.copy())
    other = TanhNormal(new.loc, new.scale, low=-7.0, high=7.0)
    with pytest.raises(ValueError, match=r"one range of actions, got low .*at collection and"):
        _kl(other, new)


def test_rollouts_without_the_distributions_parameters_say_who_writes_them(problem):
    policy, batch = problem
    with pytest.raises(KeyError, match=r"TRPOLoss reads 'loc'.*The policy writes it at collection"):
        TRPOLoss(policy)(batch.exclude("loc", "scale"))
