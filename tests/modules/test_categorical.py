"""The policy of discrete actions against the definition of its distribution."""

import math

import pytest
import torch
from tensordict import TensorDict
from torch.distributions import Categorical
from torchrl.envs.utils import ExplorationType, set_exploration_type

from pemirl_trl import CategoricalPolicy, MetaILLoss, ModelConfig, PEMIRLModel, TRPOLoss
from pemirl_trl.optim import TrustRegionOptimizer

N, S, A, D, SHARE = 400, 3, 4, 2, 0.2


def batch(n=N):
    return TensorDict({"observation": torch.randn(n, S), "context": torch.randn(n, D)}, [n])


def probabilities(policy, inputs):
    logits = policy.net(torch.cat([inputs["observation"], inputs["context"]], -1))
    return (1 - SHARE) * torch.softmax(logits, -1) + SHARE / A


@pytest.fixture
def policy():
    policy = CategoricalPolicy(S, A, D, hidden=(8,), initial_scale=SHARE)
    with torch.no_grad():
        policy.net[-1].weight *= 10.0  # preferences that can be told from chance
    return policy


def test_actions_are_one_hot_reals_of_the_stated_probability(policy):
    inputs = batch()
    with set_exploration_type(ExplorationType.RANDOM):
        result = policy(inputs.copy())
    assert result["action"].dtype == torch.get_default_dtype()
    assert (result["action"].sum(-1) == 1).all()
    assert ((result["action"] == 0) | (result["action"] == 1)).all()
    expected = Categorical(probabilities(policy, inputs))
    index = result["action"].argmax(-1)
    torch.testing.assert_close(result["action_log_prob"], expected.log_prob(index))
    distribution = policy.get_dist(inputs.copy())
    torch.testing.assert_close(distribution.entropy(), expected.entropy())
    torch.testing.assert_close(distribution.mean, expected.probs)


def test_actions_are_drawn_as_often_as_they_are_probable(policy):
    inputs = batch(1).expand(20_000).clone()
    with set_exploration_type(ExplorationType.RANDOM):
        drawn = policy(inputs.copy())["action"].mean(0)
    expected = probabilities(policy, inputs[:1])[0]
    torch.testing.assert_close(drawn, expected, atol=0.015, rtol=0)


def test_deterministic_exploration_takes_the_likeliest(policy):
    inputs = batch()
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        action = policy(inputs.copy())["action"]
    assert torch.equal(action.argmax(-1), probabilities(policy, inputs).argmax(-1))
    assert action.dtype == torch.get_default_dtype()


def test_the_share_of_uniform_actions_bounds_every_log_probability(policy):
    with torch.no_grad():
        policy.net[-1].weight *= 1e4
    log_prob = policy.get_dist(batch()).logits
    assert log_prob.min() >= math.log(SHARE / A) - 1e-5
    assert log_prob.max() <= policy.log_peak + 1e-5
    torch.testing.assert_close(log_prob.max(), policy.log_peak)


def test_the_surrogate_and_its_constraint_are_those_of_categorical_distributions(policy, float64):
    policy = policy.double()
    inputs = batch()
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        data = policy(inputs.copy()).set("advantage", torch.randn(N, 1))
        old = probabilities(policy, inputs)
        policy.net[0].weight += 0.1 * torch.randn_like(policy.net[0].weight)
    new = probabilities(policy, inputs)
    losses = TRPOLoss(policy)(data)
    kl = (old * (old.log() - new.log())).sum(-1).mean()
    index = data["action"].argmax(-1, keepdim=True)
    ratio = new.gather(1, index) / old.gather(1, index)
    torch.testing.assert_close(losses["kl"], kl)
    torch.testing.assert_close(losses["loss_objective"], -(ratio * data["advantage"]).mean())
    entropy = -(new * new.log()).sum(-1).mean()
    torch.testing.assert_close(losses["entropy"], entropy.detach())


def test_the_trust_region_step_is_a_dense_solve_with_the_fisher_information(policy, float64):
    """F = E_s sum_a pi(a|s) g_a g_a' with g_a = grad log pi(a|s): no closed form of a Gaussian."""
    policy = policy.double()
    with torch.no_grad(), set_exploration_type(ExplorationType.RANDOM):
        data = policy(batch(60)).set("advantage", torch.randn(60, 1))
    parameters = [p for p in policy.parameters() if p.requires_grad]
    names = [name for name, p in policy.named_parameters() if p.requires_grad]
    flat = torch.cat([p.detach().reshape(-1) for p in parameters])

    def log_probabilities(vector):
        pieces = vector.split([p.numel() for p in parameters])
        values = {n: v.view_as(p) for n, v, p in zip(names, pieces, parameters, strict=True)}
        inputs = data["observation"], data["context"]
        net = policy.module[0].net
        local = {name.removeprefix("module.0.net."): value for name, value in values.items()}
        return torch.func.functional_call(net, local, inputs)[0]

    jacobian = torch.func.jacrev(log_probabilities)(flat)  # [60, A, P]
    pi = log_probabilities(flat).exp()
    fisher = torch.einsum("na,nap,naq->pq", pi, jacobian, jacobian) / 60
    index = data["action"].argmax(-1)
    score = jacobian[torch.arange(60), index]
    gradient = -(score * data["advantage"]).mean(0)
    damping, radius = 1e-2, 1e-6
    direction = torch.linalg.solve(fisher + damping * torch.eye(len(flat)), -gradient)
    curvature = direction @ (fisher @ direction + damping * direction)
    expected = direction * (2 * radius / curvature).sqrt()
    optimizer = TrustRegionOptimizer(
        policy.parameters(), max_kl=radius, cg_iterations=200, damping=damping
    )
    loss = TRPOLoss(policy)

    def closure():
        losses = loss(data)
        return losses["loss_objective"], losses["kl"]

    result = optimizer.step(closure)
    moved = torch.cat([p.detach().reshape(-1) for p in parameters]) - flat
    assert result.accepted
    expected = 0.8**result.backtracks * expected
    # The conjugate gradient stops at a relative residual of 1e-5.
    assert (moved - expected).norm() < 1e-3 * expected.norm()
    plain = -gradient * (moved.norm() / gradient.norm())  # what no Fisher information would give
    assert (moved - plain).norm() > 0.1 * expected.norm()


def test_imitation_is_the_cross_entropy_of_the_demonstrated_choices():
    model = PEMIRLModel(S, A, 5, ModelConfig(context_dim=D, actions="discrete", policy_scale=0.1))
    with torch.no_grad():  # m is nearly its mean
        for module in model.encoder.modules():
            if hasattr(module, "log_scale"):
                module.log_scale.fill_(-12.0)
    action = torch.nn.functional.one_hot(torch.randint(A, (6, 5)), A).float()
    observation = torch.randn(6, 6, S)
    data = TensorDict(
        {"observation": observation[:, :-1], "action": action},
        [6],
    )
    losses = MetaILLoss(model.encoder, model.policy)(data)
    m = model.encoder.get_dist(data).mean.detach()
    inputs = TensorDict(
        {"observation": data["observation"], "context": m.unsqueeze(1).expand(6, 5, D)}, [6, 5]
    )
    logits = model.policy.get_dist(inputs).logits
    expected = torch.nn.functional.nll_loss(logits.flatten(0, 1), action.argmax(-1).flatten())
    torch.testing.assert_close(losses["loss_imitation"], expected, atol=1e-3, rtol=1e-3)


@pytest.mark.parametrize("scale", [0.0, 1.0, 3.0])
def test_a_share_that_is_none_is_refused(scale):
    with pytest.raises(ValueError, match=r"share that is drawn uniformly, between 0 and 1"):
        CategoricalPolicy(S, A, D, initial_scale=scale)
    if scale > 0:
        with pytest.raises(ValueError, match="policy_scale is"):
            ModelConfig(actions="discrete", policy_scale=scale)


def test_a_single_choice_is_none():
    with pytest.raises(ValueError, match="at least 2"):
        CategoricalPolicy(S, 1, D)


def test_a_model_makes_policies_of_its_kind():
    model = PEMIRLModel(S, A, 5, ModelConfig(actions="discrete", policy_scale=0.1))
    trained = model.trained_policy(0.5)
    assert isinstance(trained, CategoricalPolicy)
    assert float(trained.log_scale.exp()) == pytest.approx(0.5)
    inputs = TensorDict({"observation": torch.randn(9, S), "context": torch.randn(9, 3)}, [9])
    likeliest = [p.get_dist(inputs.copy()).mode for p in (trained, model.policy)]
    assert torch.equal(*likeliest)
