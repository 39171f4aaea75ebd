"""A loss moves the parameters of its optimiser and nothing else."""

import torch
from torch.optim import SGD

from pemirl_trl.optim import descend


def test_only_the_optimisers_parameters_move_and_no_gradient_stays():
    mine, other, unused = (torch.nn.Parameter(torch.tensor(v)) for v in (3.0, 5.0, 7.0))
    other.grad = torch.tensor(11.0)
    descend(SGD([mine, unused], lr=0.1), mine * other)
    assert mine.item() == 3.0 - 0.1 * 5.0
    assert (other.item(), other.grad.item(), unused.item()) == (5.0, 11.0, 7.0)
    assert mine.grad is None


def test_two_losses_of_one_graph_use_the_same_old_values():
    """Simultaneous steps: the second gradient does not see the first one's step."""
    psi, theta = torch.nn.Parameter(torch.tensor(2.0)), torch.nn.Parameter(torch.tensor(3.0))
    product = psi.exp() * theta
    descend(SGD([psi], lr=1.0), product, retain_graph=True)
    descend(SGD([theta], lr=1.0), product)
    assert torch.isclose(psi, torch.tensor(2.0) - 3.0 * torch.tensor(2.0).exp())
    assert torch.isclose(theta, torch.tensor(3.0) - torch.tensor(2.0).exp())
