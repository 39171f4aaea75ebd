"""Consolidation moves the reward alone, without the environment."""

import copy

import pytest
import torch

from pemirl_trl.methods import BatchConfig, Consolidation, ConsolidationConfig


def consolidation(problem, **config):
    model = problem.model()
    meta_training = problem.pemirl(model=model, archive_iterations=2, replay_iterations=1)
    for _ in range(2):
        meta_training.iteration()
    batch = BatchConfig(
        trajectories=16, time_steps=5, current_fraction=0.0, jitter_fraction=0.7, jitter_scale=1.5
    )
    config = ConsolidationConfig(steps=40, steps_per_iteration=20, batch=batch, **config)
    return Consolidation(model, problem.demonstrations, meta_training.negatives, config)


def test_the_reward_alone_moves(reach):
    method = consolidation(reach)
    before = copy.deepcopy(method.model.state_dict())
    negatives = {name: v.clone() for name, v in method.negatives.state_dict().items()}
    for _ in range(method.iterations):
        method.iteration()
    moved = {n for n, v in method.model.state_dict().items() if not torch.equal(v, before[n])}
    assert moved == {f"reward.{n}" for n, _ in method.model.reward.named_parameters()}
    assert all(torch.equal(v, negatives[n]) for n, v in method.negatives.state_dict().items())
    assert method.env_steps == 0


def test_the_learning_rate_decays_to_its_end(reach):
    method = consolidation(reach, lr=1e-2, final_lr=1e-3)
    rates = []
    for _ in range(method.iterations):
        method.iteration()
        rates.append(method.components()["optimizer"].param_groups[0]["lr"])
    assert rates == [pytest.approx(1e-2 / 10**0.5), pytest.approx(1e-3)]


def test_the_penalty_flattens_the_reward(reach):
    def slope(coefficient):
        torch.manual_seed(0)
        method = consolidation(reach, gradient_penalty_coeff=coefficient, lr=1e-2)
        for _ in range(method.iterations):
            method.iteration()
        grid = torch.linspace(-1.0, 1.0, 50).unsqueeze(-1).requires_grad_()
        reward = method.model.reward.reward(grid, torch.zeros(50, 3))
        return float(torch.autograd.grad(reward.sum(), grid)[0].square().mean())

    assert slope(10.0) < 0.1 * slope(0.0)
