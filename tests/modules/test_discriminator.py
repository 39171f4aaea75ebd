"""GAIL's discriminator: one number under two names, and its optimum. AIRL's: test_reward.py."""

import torch
from tensordict import TensorDict

from pemirl_trl.modules import GAILDiscriminator
from pemirl_trl.objectives import DiscriminatorLoss


def test_the_reward_is_the_logit():
    batch = TensorDict({"observation": torch.randn(5, 4, 3), "action": torch.randn(5, 4, 2)}, [5])
    result = GAILDiscriminator(3, 2)(batch)
    assert result["logit_expert"].shape == (5, 4, 1)
    assert torch.equal(result["learned_reward"], result["logit_expert"])


def test_the_optimal_logit_is_the_log_ratio_of_the_densities(float64):
    """Two states and two actions; of 12 pairs each, so many are the expert's and the policy's."""
    expert, policy = torch.tensor([6, 3, 1, 2]), torch.tensor([1, 2, 3, 6])
    index = torch.arange(4).repeat(2).repeat_interleave(torch.cat([expert, policy]))
    batch = TensorDict(
        {
            "observation": torch.eye(2)[index // 2],
            "action": torch.eye(2)[index % 2],
            "is_expert": torch.arange(24) < 12,
        },
        [24],
    )
    discriminator = GAILDiscriminator(2, 2, hidden=(16,))
    loss = DiscriminatorLoss(discriminator)
    optimizer = torch.optim.LBFGS(
        discriminator.parameters(), max_iter=200, line_search_fn="strong_wolfe"
    )

    def closure():
        optimizer.zero_grad()
        value = loss(batch)["loss_discriminator"]
        value.backward()
        return value

    optimizer.step(closure)
    pairs = {"observation": torch.eye(2)[[0, 0, 1, 1]], "action": torch.eye(2)[[0, 1, 0, 1]]}
    logit = discriminator(TensorDict(pairs, [4]))["logit_expert"].squeeze(-1)
    # Not a sum of a function of s and one of a: ln 6 + ln 1/3 is not ln 3/2 + ln 1/3.
    expected = torch.tensor([6.0, 3 / 2, 1 / 3, 1 / 3]).log()
    torch.testing.assert_close(logit, expected, atol=1e-3, rtol=0)
