"""Information that holds under other dynamics, against what is known in closed form."""

import math

import pytest
import torch

from pemirl_trl.evaluation import agreed_contexts, held_out_information

BODIES, EACH, HORIZON = 4, 200, 10
# m is a coin; the partner's m is the same or the other one with probability 1/2. Where a component
# shows m without error, r separates the half of the pairs that differ: the Jensen-Shannon bound of
# p(s | m) and p(s), log 2 - (3/4 H2(2/3)), where H2(2/3) is the entropy of one part in three.
PERFECT = math.log(2) - 0.75 * (math.log(3) - 2 / 3 * math.log(2))


def family(seed=0):
    """Component 0 shows m everywhere; 1 does too, with a sign that each body has; 2 is noise."""
    generator = torch.Generator().manual_seed(seed)
    bodies = torch.arange(BODIES).repeat_interleave(EACH)
    m = torch.tensor([1.0, -1.0]).repeat(BODIES * EACH // 2)
    sign = torch.tensor([1.0, -1.0, 1.0, -1.0])[bodies]
    noise = torch.randn(BODIES * EACH, HORIZON, 3, generator=generator)
    meaning = torch.stack([m, m * sign, torch.zeros_like(m)], -1).unsqueeze(1)
    return torch.where(meaning == 0, noise, meaning + 0.1 * noise), m.unsqueeze(-1), bodies


def test_finds_what_tells_tasks_apart_in_every_body():
    generator = torch.Generator().manual_seed(1)
    information = held_out_information(*family(), generator=generator)
    assert information.shape == (BODIES, 3)
    torch.testing.assert_close(information[:, 0], torch.full((BODIES,), PERFECT), rtol=0, atol=0.04)
    # The other bodies contradict each other, two to one against the body that is left out.
    assert (information[:, 1] < -0.02).all()
    assert information[:, 2].abs().max() < 0.02


def test_what_one_value_of_a_bin_is_called_does_not_matter():
    observations, contexts, bodies = family()
    results = [
        held_out_information(
            *(scale * observations + 5.0, 3.0 * contexts - 1.0, bodies),
            generator=torch.Generator().manual_seed(1),
        )
        for scale in (1.0, 100.0)
    ]
    torch.testing.assert_close(*results, rtol=0, atol=1e-3)


def test_bounds_and_bad_input():
    observations, contexts, bodies = family()
    assert held_out_information(observations, contexts, bodies).max() < math.log(2)
    with pytest.raises(ValueError, match="of one body"):
        held_out_information(observations, contexts, torch.zeros_like(bodies))
    with pytest.raises(ValueError, match=r"contexts \[799, 1\]"):
        held_out_information(observations, contexts[1:], bodies)


def test_what_demonstrations_of_a_task_agree_on():
    """Of m = (task, body, chance) the first axis is kept, with the mean of the bodies that stay."""
    generator = torch.Generator().manual_seed(0)
    task, body = torch.arange(40) % 4, torch.arange(40) // 4 % 2
    values = torch.tensor([-3.0, -1.0, 1.0, 3.0])
    own = values[task] + 0.01 * torch.randn(40, generator=generator)
    chance = torch.randn(40, generator=generator)
    contexts = torch.stack([own, 5.0 * body, chance], -1)
    agreed = agreed_contexts(contexts, task, body)
    assert agreed.shape == (2, 40, 1)
    for left_out in range(2):
        stays = body != left_out
        means = torch.stack([own[stays & (task == i)].mean() for i in range(4)])
        found = agreed[left_out, :, 0]
        assert torch.equal(found[:4].repeat(10), found)  # one value for a task, whichever body
        correlation = torch.corrcoef(torch.stack([found, means[task]]))[0, 1]
        assert correlation.abs() > 0.9999


def test_a_task_of_one_body_leaves_nothing_to_agree_on():
    with pytest.raises(ValueError, match="demonstrated by one body alone"):
        agreed_contexts(torch.randn(4, 2), torch.tensor([0, 0, 1, 1]), torch.tensor([0, 1, 0, 0]))
