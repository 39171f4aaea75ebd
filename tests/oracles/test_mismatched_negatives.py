"""Against mismatched negatives alone the logit is a pointwise mutual information, known here."""

import pytest
import torch
from tensordict import TensorDict
from torch.distributions import Independent, Normal

from pemirl_trl import AIRLDiscriminator, DiscriminatorLoss, ModelConfig, PEMIRLModel
from pemirl_trl.data import Negatives
from pemirl_trl.methods import BatchConfig, DiscriminatorBatches
from pemirl_trl.optim import descend

DEMONSTRATIONS = 4000


class Known:
    """q(m | tau), certain of the task, which stands in the last component of an observation."""

    in_keys = ("observation",)

    @staticmethod
    def get_dist(demonstrations):
        task = demonstrations["observation"][:, 0, 2:]
        return Independent(Normal(task, 1e-6), 1)


def demonstrations():
    """Of one step: x ~ N(m, 1) tells the task m = +-1, y ~ N(2, 1) is what both have in common."""
    task = torch.randint(2, (DEMONSTRATIONS, 1, 1)) * 2.0 - 1.0
    x, y = task + torch.randn_like(task), 2.0 + torch.randn_like(task)
    observation = torch.cat([x, y, task], -1)
    return TensorDict(
        {
            "observation": observation,
            "action": torch.zeros(DEMONSTRATIONS, 1, 1),
            "next": {"observation": observation},
        },
        [DEMONSTRATIONS],
    )


@pytest.mark.parametrize("relative", [False, True])
def test_the_reward_is_the_mutual_information_of_state_and_context(relative):
    torch.manual_seed(0)
    sizes = ModelConfig(context_dim=1, reward_features=(0, 1), reward_gamma=0.0)
    model = PEMIRLModel(3, 1, 1, sizes)
    for name, parameter in model.named_parameters():
        if not name.startswith("reward.reward_net"):  # h = 0, and log pi is the same everywhere
            parameter.data.zero_()
            parameter.requires_grad_(False)
    del model.encoder
    object.__setattr__(model, "encoder", Known())
    config = BatchConfig(
        trajectories=1000, time_steps=1, mismatched_fraction=1.0, relative_log_prob=relative
    )
    batches = DiscriminatorBatches(model, demonstrations(), Negatives(1), config)
    loss = DiscriminatorLoss(AIRLDiscriminator(model.reward))
    optimizer = torch.optim.Adam(model.reward.reward_net.parameters(), lr=1e-2)
    for step in range(400):
        optimizer.param_groups[0]["lr"] = 1e-2 * 10 ** (-step / 200)
        descend(optimizer, loss(batches.sample(1))["loss_discriminator"])

    x, y = torch.meshgrid(torch.linspace(-2, 2, 9), torch.linspace(1, 3, 5), indexing="ij")
    state = torch.stack([x, y, torch.zeros_like(x)], -1)
    # All actions stand at the policy's mean, where a relative log pi is 0.
    log_pi = 0.0 if relative else Normal(0.0, 1.0).log_prob(torch.tensor(0.0))
    with torch.no_grad():
        for m in (-1.0, 1.0):
            learned = model.reward.reward(state, torch.full((9, 5, 1), m)).squeeze(-1) - log_pi
            # log N(x; m, 1) - log(N(x; -1, 1) / 2 + N(x; 1, 1) / 2); y does not appear.
            exact = -torch.log(0.5 + 0.5 * torch.exp(-2 * m * x))
            assert (learned - exact).abs().mean() < 0.1
            assert learned.std(1).mean() < 0.1  # along y
            assert exact.std(0).mean() > 0.8  # along x
