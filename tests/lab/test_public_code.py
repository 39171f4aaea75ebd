"""The public code's information term: what its gradients are, and are not."""

import pytest
import torch
from tensordict import TensorDict

from pemirl_lab.public_code import PublicCodeInfoLoss
from pemirl_trl import ModelConfig, PEMIRLModel
from pemirl_trl.methods import PEMIRLConfig

J, M, K, T, S, A, D = 5, 3, 2, 4, 3, 2, 2


@pytest.fixture
def problem(float64):
    """A model, the loss, and rollouts ``[M K, T]`` of three demonstrations."""
    model = PEMIRLModel(S, A, T, ModelConfig(context_dim=D))
    shape = {"observation": torch.randn(J, T, S), "action": torch.randn(J, T, A)}
    config = PEMIRLConfig(rollouts_per_context=K)
    loss = PublicCodeInfoLoss(model, TensorDict(shape, [J]), config)
    observation = torch.randn(M * K, T + 1, S)
    demonstration = torch.tensor([4, 0, 2]).repeat_interleave(K).unsqueeze(1).expand(M * K, T)
    rollouts = {
        "observation": observation[:, :-1],
        "next": {"observation": observation[:, 1:]},
        "demonstration": demonstration,
    }
    return model, loss, TensorDict(rollouts, [M * K, T])


def test_psi_only_shrinks_its_deviation(problem):
    """log q(mu + sigma eps) = -eps^2 / 2 - log sigma + const: no mu, and -1 per log sigma."""
    model, loss, rollouts = problem
    loss(rollouts)["loss_info_encoder"].backward()
    for name, parameter in model.encoder.named_parameters():
        if name.endswith("log_scale"):
            torch.testing.assert_close(parameter.grad, torch.ones(D))
        else:
            assert parameter.grad.abs().max() < 1e-12, name


def test_theta_alone_follows_the_reward_loss(problem):
    model, loss, rollouts = problem
    loss(rollouts)["loss_info_reward"].backward()
    assert all(p.grad is None for p in model.encoder.parameters())
    assert all(p.grad.abs().sum() > 0 for p in model.reward.reward_net[0].parameters())


def test_what_multiplies_a_return_says_nothing_about_the_rollout(problem):
    """Other rollouts of the same demonstrations: log q, under the same draw, is the same."""
    _, loss, rollouts = problem
    torch.manual_seed(1)
    expected = loss(rollouts)
    rollouts["observation"] = rollouts["observation"] + 5.0
    torch.manual_seed(1)
    result = loss(rollouts)
    assert torch.equal(result["log_q"], expected["log_q"])
    assert not torch.equal(result["loss_info_reward"], expected["loss_info_reward"])
