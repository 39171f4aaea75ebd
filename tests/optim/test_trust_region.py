"""The trust-region step on models whose answer is known in closed form."""

import pytest
import torch

from pemirl_trl.optim import TrustRegionOptimizer


class Quadratic:
    """Loss b.x and KL 1/2 d'Fd (1 + excess d'Fd), d = x - x0: the step is known exactly.

    The parameters are two tensors, so that flattening and splitting them matters.
    """

    def __init__(self, excess=0.0):
        root = torch.randn(5, 5)
        self.fisher = root @ root.T + torch.eye(5)
        self.slope = torch.randn(5)
        self.params = [torch.nn.Parameter(torch.randn(shape)) for shape in ((2,), (3, 1))]
        self.start = self.flat().detach().clone()
        self.excess = excess

    def flat(self):
        return torch.cat([p.flatten() for p in self.params])

    def moved(self):
        return (self.flat() - self.start).detach()

    def kl(self, factor=1.0):
        d = self.flat() - self.start
        half = 0.5 * factor * d @ self.fisher @ d
        return half + self.excess * half.square()

    def closure(self):
        return self.slope @ self.flat(), self.kl()

    def step(self, max_kl, fisher):
        """-sqrt(2 max_kl / b' F^-1 b) F^-1 b."""
        direction = torch.linalg.solve(fisher, self.slope)
        return -direction * (2 * max_kl / (self.slope @ direction)).sqrt()


@pytest.fixture
def model(float64):
    return Quadratic()


def optimizer(model, **kwargs):
    settings = {"max_kl": 0.03, "damping": 0.0, "cg_iterations": 20} | kwargs
    return TrustRegionOptimizer(model.params, **settings)


@pytest.mark.parametrize("damping", [1e-9, 0.5])
def test_the_step_is_the_natural_gradient_at_the_edge_of_the_region(model, damping):
    result = optimizer(model, damping=damping).step(model.closure)
    expected = model.step(0.03, model.fisher + damping * torch.eye(5))
    assert torch.allclose(model.moved(), expected, rtol=1e-5)
    assert (result.accepted, result.reason, result.backtracks) == (True, "accepted", 0)
    assert result.kl == pytest.approx(model.kl().item())
    assert result.kl <= 0.03
    promised = -(model.slope @ expected).item()  # the loss is linear: it is also what comes
    assert result.expected_improvement == pytest.approx(promised, rel=1e-5)
    assert result.improvement == pytest.approx(promised, rel=1e-5)
    assert result.gradient_norm == pytest.approx(model.slope.norm().item())
    assert result.cg_residual < 1e-4


def test_a_separate_fisher_closure_sets_the_metric(model):
    optimizer(model).step(model.closure, lambda: model.kl(factor=4.0))
    assert torch.allclose(model.moved(), model.step(0.03, 4.0 * model.fisher), rtol=1e-5)


@pytest.mark.parametrize("factor", [1e-8, 1e8])
def test_the_scale_of_the_loss_does_not_matter(model, factor):
    def closure():
        loss, kl = model.closure()
        return factor * loss, kl

    optimizer(model, damping=1e-9).step(closure)
    assert torch.allclose(model.moved(), model.step(0.03, model.fisher), rtol=1e-4)


def test_backtracking_restores_the_bound(float64):
    model = Quadratic(excess=100.0)  # the true KL grows faster than its quadratic model
    result = optimizer(model, backtrack_ratio=0.5).step(model.closure)
    full = model.step(0.03, model.fisher)
    assert result.accepted
    # 0.03 r^2 + 100 (0.03 r^2)^2 <= 0.03 holds for r = 1/2 and not for r = 1.
    assert result.backtracks == 1
    assert torch.allclose(model.moved(), 0.5 * full, rtol=1e-5)
    assert result.kl == pytest.approx(0.0075 + 100 * 0.0075**2, rel=1e-5)
    assert result.improvement == pytest.approx(0.5 * result.expected_improvement, rel=1e-5)


def test_a_rejected_step_restores_every_bit_in_place():
    model = Quadratic()  # float32, where adding and subtracting a step would not restore
    before = [(p.data_ptr(), p.detach().clone()) for p in model.params]
    result = optimizer(model, accept_ratio=1e9, max_backtracks=4).step(model.closure)
    assert (result.accepted, result.reason) == (False, "line_search_failed")
    assert (result.backtracks, result.kl, result.improvement) == (4, 0.0, 0.0)
    for parameter, (pointer, value) in zip(model.params, before, strict=True):
        assert parameter.data_ptr() == pointer
        assert torch.equal(parameter, value)


def test_an_accepted_step_is_in_place(model):
    before = [p.data_ptr() for p in model.params]
    alias = model.params[0].detach()
    old = alias.clone()
    assert optimizer(model).step(model.closure).accepted
    assert [p.data_ptr() for p in model.params] == before
    assert not torch.equal(alias, old)


def test_a_frozen_parameter_and_one_out_of_reach_stay(model):
    frozen = torch.nn.Parameter(torch.ones(3), requires_grad=False)
    unused = torch.nn.Parameter(torch.ones(2))
    result = TrustRegionOptimizer([frozen, *model.params, unused], max_kl=0.03).step(model.closure)
    assert result.accepted
    assert torch.equal(unused, torch.ones(2))
    assert torch.equal(frozen, torch.ones(3))


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda loss, kl: (0.0 * loss, kl), "zero_gradient"),
        (lambda loss, kl: (loss * torch.nan, kl), "not_finite"),
        (lambda loss, kl: (loss, kl * torch.nan), "not_finite"),
        (lambda loss, kl: (loss, -kl), "not_finite"),  # no curvature to step by
        (lambda loss, kl: (loss + torch.nan, kl), "line_search_failed"),
    ],
)
def test_a_spoiled_problem_changes_nothing_and_says_why(model, spoil, reason):
    result = optimizer(model).step(lambda: spoil(*model.closure()))
    assert (result.accepted, result.reason) == (False, reason)
    assert torch.equal(model.moved(), torch.zeros(5))


def test_a_loss_that_breaks_along_the_way_is_never_accepted(model):
    """Not a number wherever the step is longer than 0.3 of the full one."""
    full = model.step(0.03, model.fisher).norm()

    def closure():
        loss, kl = model.closure()
        return (loss if model.moved().norm() < 0.3 * full else loss * torch.nan), kl

    result = optimizer(model).step(closure)
    assert result.accepted
    assert model.moved().norm() < 0.3 * full


@pytest.mark.parametrize(
    ("kwargs", "message"),
    [
        ({"max_kl": 0.0}, "max_kl > 0"),
        ({"damping": -1.0}, "damping >= 0"),
        ({"cg_iterations": 0}, "cg_iterations >= 1"),
        ({"max_backtracks": 0}, "max_backtracks >= 1"),
        ({"backtrack_ratio": 1.0}, r"backtrack_ratio in \(0, 1\), got 1.0"),
    ],
)
def test_senseless_settings_are_refused(kwargs, message):
    with pytest.raises(ValueError, match=message):
        TrustRegionOptimizer([torch.nn.Parameter(torch.ones(1))], **kwargs)


def test_nothing_to_move_is_refused():
    with pytest.raises(ValueError, match="no parameter that requires a gradient"):
        TrustRegionOptimizer([torch.ones(3)])


@pytest.mark.parametrize(
    ("returned", "message"),
    [
        (lambda loss, kl: loss, r"returned a tensor of shape \[\]; expected \(loss, kl\)"),
        (lambda loss, kl: {"loss": loss}, "returned a dict; expected"),
        (lambda loss, kl: (loss, kl, kl), "two scalar tensors: with losses = TRPOLoss"),
        (lambda loss, kl: (loss.expand(3), kl), r"returned \(a tensor of shape \[3\], a tensor"),
        (lambda loss, kl: (loss, 0.0), r"a tensor of shape \[\], a float\)"),
    ],
)
def test_a_closure_that_returns_something_else_is_refused(model, returned, message):
    with pytest.raises(TypeError, match=message):
        optimizer(model).step(lambda: returned(*model.closure()))
    assert torch.equal(model.moved(), torch.zeros(5))


@pytest.mark.parametrize(
    ("detached", "name"),
    [(lambda loss, kl: (loss.detach(), kl), "loss"), (lambda loss, kl: (loss, kl.detach()), "kl")],
)
def test_a_closure_that_detaches_is_refused(model, detached, name):
    with pytest.raises(ValueError, match=f"the {name} carries no gradient.*do not detach"):
        optimizer(model).step(lambda: detached(*model.closure()))


def test_a_fisher_closure_that_detaches_is_refused(model):
    with pytest.raises(ValueError, match="kl of the fisher_closure carries no gradient"):
        optimizer(model).step(model.closure, lambda: model.kl().detach())


def test_it_is_an_optimiser_of_torch_whose_group_holds_its_settings(model):
    trust_region = optimizer(model, damping=1e-9)
    assert isinstance(trust_region, torch.optim.Optimizer)
    (group,) = trust_region.param_groups
    assert all(a is b for a, b in zip(group["params"], model.params, strict=True))
    trust_region.param_groups[0]["max_kl"] = 0.003  # as a schedule may
    trust_region.step(model.closure)
    assert torch.allclose(model.moved(), model.step(0.003, model.fisher), rtol=1e-5)


def test_its_state_moves_to_another_optimiser(float64):
    source, target = Quadratic(), Quadratic()
    target.fisher, target.slope = source.fisher, source.slope
    settings = optimizer(source, max_kl=0.002, damping=0.3).state_dict()
    other = TrustRegionOptimizer(target.params)
    other.load_state_dict(settings)
    other.param_groups[0]["cg_iterations"] = 20
    other.step(target.closure)
    expected = source.step(0.002, source.fisher + 0.3 * torch.eye(5))
    assert torch.allclose(target.moved(), expected, rtol=1e-5)
    settings["param_groups"][0]["max_kl"] = -1.0
    with pytest.raises(ValueError, match="max_kl > 0"):
        other.load_state_dict(settings)


def test_named_parameters_keep_their_names_without_the_frozen_ones(model):
    frozen = torch.nn.Parameter(torch.ones(3), requires_grad=False)
    named = [("frozen", frozen), ("a", model.params[0]), ("b", model.params[1])]
    (group,) = TrustRegionOptimizer(named).param_groups
    assert group["param_names"] == ["a", "b"]
    assert len(group["params"]) == 2


def test_a_second_trust_region_is_refused(model):
    with pytest.raises(ValueError, match="expected one parameter group, got a second one"):
        TrustRegionOptimizer([{"params": [p]} for p in model.params])
    with pytest.raises(ValueError, match="expected one parameter group, got a second one"):
        optimizer(model).add_param_group({"params": [torch.nn.Parameter(torch.ones(1))]})


def test_two_ways_to_the_fisher_information_are_refused(model):
    with pytest.raises(ValueError, match="got fisher_closure and fisher_product; expected one"):
        optimizer(model).step(model.closure, model.kl, lambda vector: vector)


def test_a_fisher_product_of_ones_own_sets_the_metric(model):
    optimizer(model).step(model.closure, fisher_product=lambda v: 4.0 * model.fisher @ v)
    assert torch.allclose(model.moved(), model.step(0.03, 4.0 * model.fisher), rtol=1e-5)
