"""What components tell together, on families whose answer is known."""

import math

import pytest
import torch

from pemirl_trl.evaluation import held_out_information, joint_information

BODIES, EACH, HORIZON = 3, 200, 10
# As in test_task_space.py: what shows a coin m without error, beside another demonstration's m.
PERFECT = math.log(2) - 0.75 * (math.log(3) - 2 / 3 * math.log(2))


def family(seed=0):
    """m is the product of the signs of components 0 and 1; 2 is m times a sign of the body."""
    generator = torch.Generator().manual_seed(seed)
    bodies = torch.arange(BODIES).repeat_interleave(EACH)
    m = torch.tensor([1.0, -1.0]).repeat(BODIES * EACH // 2)
    first = 2.0 * torch.randint(2, (BODIES * EACH, HORIZON), generator=generator) - 1
    habit = (m * torch.tensor([1.0, -1.0, 1.0])[bodies]).unsqueeze(-1).expand(-1, HORIZON)
    states = torch.stack([first, m.unsqueeze(-1) * first, habit], -1)
    noise = torch.randn(states.shape, generator=generator)
    return states + 0.1 * noise, m.unsqueeze(-1), bodies


def test_what_two_components_tell_together_is_found():
    """Neither of them tells anything by itself."""
    generator = torch.Generator().manual_seed(1)
    given = family()
    found = joint_information(*given, [[0], [1], [0, 1]], generator=generator)
    assert found.shape == (BODIES, 3)
    torch.testing.assert_close(found[:, 2], torch.full((BODIES,), PERFECT), rtol=0, atol=0.05)
    assert found[:, :2].max() < 0.02
    alone = held_out_information(*given, generator=torch.Generator().manual_seed(1))
    assert alone[:, :2].max() < 0.02


def test_a_habit_of_each_body_misleads():
    """Body 1 has the contrary of what the two others have in common."""
    generator = torch.Generator().manual_seed(1)
    found = joint_information(*family(), [[2], [0, 1]], generator=generator)
    assert found[1, 0] < -0.5
    assert found[1, 1] > 0.1


def test_a_set_does_not_see_what_is_not_in_it():
    """Its information is the same, to rounding, whatever the other sets and components are."""
    observations, contexts, bodies = family()
    changed = observations.clone()
    changed[..., 2] = torch.randn(changed[..., 2].shape)
    results = [
        joint_information(
            given, contexts, bodies, [[0, 1]], steps=50, generator=torch.Generator().manual_seed(1)
        )
        for given in (observations, changed)
    ]
    torch.testing.assert_close(*results)


@pytest.mark.parametrize("sets", [[], [[]], [[0, 3]], [[-1]]])
def test_sets_of_what_is_not_there_are_refused(sets):
    with pytest.raises(ValueError, match=r"expected some of 0 to 2"):
        joint_information(*family(), sets)
