"""One policy step against sb3-contrib's TRPO: same networks, same batch, same advantages."""

import gymnasium
import numpy as np
import pytest
import torch
from sb3_contrib import TRPO
from stable_baselines3.common.logger import Logger
from tensordict import TensorDict

from pemirl_trl.modules import ContextPolicy
from pemirl_trl.objectives import TRPOLoss
from pemirl_trl.optim import TrustRegionOptimizer

ROWS = 64
SETTINGS = {"max_kl": 0.01, "cg_iterations": 15, "damping": 0.1, "max_backtracks": 10}


class Line(gymnasium.Env):
    """Only its spaces are used. One action: sb3's KL is a mean over actions, ours their sum."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (3,), np.float32)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)


@pytest.fixture
def peer():
    model = TRPO(
        "MlpPolicy",
        Line(),
        n_steps=ROWS,
        batch_size=ROWS,
        normalize_advantage=False,
        target_kl=SETTINGS["max_kl"],
        cg_max_steps=SETTINGS["cg_iterations"],
        cg_damping=SETTINGS["damping"],
        line_search_max_iter=SETTINGS["max_backtracks"],
        n_critic_updates=1,
        policy_kwargs={"net_arch": [8, 8]},
        device="cpu",
        seed=0,
    )
    model.set_logger(Logger(folder=None, output_formats=[]))
    with torch.no_grad():  # sb3 starts with means near zero, a special point
        for parameter in model.policy.parameters():
            parameter.add_(0.2 * torch.randn_like(parameter))
    return model


def parts(model):
    """Its actor's parameters, in the order of ours: layers, mean, then the deviation."""
    policy = model.policy
    layers = [*policy.mlp_extractor.policy_net.parameters(), *policy.action_net.parameters()]
    return [*layers, policy.log_std]


def ours(model):
    policy = ContextPolicy(3, 1, 0, hidden=(8, 8), activation=torch.nn.Tanh)
    mine = [*policy.gaussian.net.parameters(), policy.log_scale]
    with torch.no_grad():
        for parameter, value in zip(mine, parts(model), strict=True):
            parameter.copy_(value)
    return policy, mine


def fill(buffer, batch):
    columns = {"observations": "observation", "actions": "action"}
    for name, key in columns.items():
        getattr(buffer, name)[:] = batch[key].numpy().reshape(getattr(buffer, name).shape)
    buffer.log_probs[:, 0] = batch["action_log_prob"].numpy()
    buffer.advantages[:, 0] = batch["advantage"].numpy()
    buffer.full = True


def test_the_step_is_that_of_sb3(peer):
    policy, mine = ours(peer)
    with torch.no_grad():
        batch = TensorDict(
            {"observation": torch.randn(ROWS, 3), "context": torch.zeros(ROWS, 0)}, [ROWS]
        )
        distribution = policy.get_dist(batch)
        action = distribution.sample()
        batch.update({"loc": distribution.mean, "scale": distribution.stddev, "action": action})
        batch["action_log_prob"] = distribution.log_prob(action)
        batch["advantage"] = torch.randn(ROWS)
        theirs = peer.policy.get_distribution(batch["observation"])
        assert torch.allclose(theirs.log_prob(action), batch["action_log_prob"], atol=1e-5)
    old = torch.nn.utils.parameters_to_vector(mine).detach().clone()

    loss = TRPOLoss(policy)

    def closure():
        losses = loss(batch)
        return losses["loss_objective"], losses["kl"]

    result = TrustRegionOptimizer(mine, **SETTINGS).step(closure)
    fill(peer.rollout_buffer, batch)
    peer.train()

    step = torch.nn.utils.parameters_to_vector(mine).detach() - old
    their_step = torch.nn.utils.parameters_to_vector(parts(peer)).detach() - old
    assert result.accepted
    assert step.norm() > 0.01
    assert (step - their_step).norm() < 1e-4 * step.norm()
