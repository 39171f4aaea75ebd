"""The information loss refuses batches whose rows are not K rollouts of each context."""

import math

import pytest
import torch

from pemirl_trl.functional import info_reward_loss
from pemirl_trl.objectives import InfoLoss

from .problems import K, M, networks, rollouts


@pytest.fixture
def problem(float64):
    return networks(), rollouts()


def test_both_losses_from_their_parts(problem):
    nets, batch = problem
    result = InfoLoss(nets.encoder, nets.reward, rollouts_per_context=K)(batch)
    trajectories = batch.select("observation", "action")
    trajectories.batch_size = batch.shape[:1]
    log_q = nets.encoder.get_dist(trajectories).log_prob(batch["context"][:, 0])
    returns = nets.reward(batch.copy())["shaped_reward"].sum((1, 2))
    assert torch.isclose(result["loss_info_encoder"], -log_q.mean())
    assert torch.isclose(result["log_q"], log_q.mean())
    expected = info_reward_loss(log_q.view(M, K), returns.view(M, K))
    assert torch.isclose(result["loss_info_reward"], expected)


@pytest.mark.parametrize("summand", ["shaped", "state"])
def test_only_f_trains_the_potential(problem, summand):
    nets, batch = problem
    loss = InfoLoss(nets.encoder, nets.reward, rollouts_per_context=K, summand=summand)
    (gradient,) = torch.autograd.grad(
        loss(batch)["loss_info_reward"], nets.reward.potential_net[-1].weight, allow_unused=True
    )
    assert (gradient is None) == (summand == "state")


def test_a_batch_without_time_in_its_size_gives_the_same(problem):
    nets, batch = problem
    loss = InfoLoss(nets.encoder, nets.reward, rollouts_per_context=K)
    expected = loss(batch)
    batch.batch_size = batch.shape[:1]
    assert (loss(batch) == expected).all()


def test_no_gradient_reaches_the_context(problem):
    nets, batch = problem
    batch["context"] = batch["context"].clone().requires_grad_()
    result = InfoLoss(nets.encoder, nets.reward, rollouts_per_context=K)(batch)
    (result["loss_info_encoder"] + result["loss_info_reward"]).backward()
    assert batch["context"].grad is None


def test_rows_that_do_not_divide_are_refused(problem):
    nets, batch = problem
    with pytest.raises(ValueError, match="got 6 rollouts, which 4 rollouts per context"):
        InfoLoss(nets.encoder, nets.reward, rollouts_per_context=4)(batch)


def test_groups_with_different_contexts_are_refused(problem):
    nets, batch = problem
    loss = InfoLoss(nets.encoder, nets.reward, rollouts_per_context=K)
    with pytest.raises(ValueError, match="must stand in a row and share it"):
        loss(batch[torch.tensor([0, 2, 1, 3, 4, 5])])


def test_a_single_rollout_has_no_covariance(problem):
    nets, batch = problem
    with pytest.raises(ValueError, match="at least 2 rollouts per context, got 1"):
        InfoLoss(nets.encoder, nets.reward, rollouts_per_context=1)(batch)


def test_an_unknown_summand_is_refused(problem):
    nets, _ = problem
    with pytest.raises(ValueError, match=r"'reward'; choose one of .*'shaped', 'state'"):
        InfoLoss(nets.encoder, nets.reward, rollouts_per_context=K, summand="reward")


def test_the_bounded_form_is_of_the_mixture_and_reaches_each_network_alone(problem):
    nets, batch = problem
    bounded = {"form": "tilted", "prior_fraction": 0.01, "time_mean": True}
    losses = InfoLoss(nets.encoder, nets.reward, rollouts_per_context=K, **bounded)(batch)
    plain = InfoLoss(nets.encoder, nets.reward, rollouts_per_context=K)(batch)
    assert losses["log_q"] >= plain["log_q"] + math.log(0.99)  # no rollout counts without end
    for key, network in (("loss_info_encoder", nets.encoder), ("loss_info_reward", nets.reward)):
        reached = torch.autograd.grad(
            losses[key], [*network.parameters()], retain_graph=True, allow_unused=True
        )
        assert any(g is not None and g.abs().sum() > 0 for g in reached)


def test_forms_that_do_not_exist_or_fit_are_refused(problem):
    nets, _ = problem
    for options, message in (
        ({"form": "rank"}, "unknown form 'rank'; choose one of"),
        ({"form": "tilted", "normalize": True}, "the tilted form needs none"),
    ):
        with pytest.raises(ValueError, match=message):
            InfoLoss(nets.encoder, nets.reward, rollouts_per_context=K, **options)
