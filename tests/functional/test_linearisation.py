"""J v and J^T u of an MLP, against automatic differentiation."""

import pytest
import torch
from torch import nn

from pemirl_trl.functional.linearisation import pull_back, push_forward
from pemirl_trl.modules.network import RowwiseMLP


@pytest.mark.parametrize("activation", [nn.ReLU, nn.Tanh])
@pytest.mark.parametrize("hidden", [(), (5,), (5, 4)])
def test_both_passes_are_those_of_automatic_differentiation(activation, hidden):
    net = RowwiseMLP(3, 2, hidden, activation).double()
    batch = torch.randn(7, 3, dtype=torch.float64)
    parameters = list(net.parameters())
    moves = [torch.randn_like(value) for value in parameters]
    cotangent = torch.randn(7, 2, dtype=torch.float64)
    output = net(batch)
    backward = torch.autograd.grad(output, parameters, cotangent, retain_graph=True)
    forward = [  # each entry of J v is one gradient times v
        sum(
            (gradient * move).sum()
            for gradient, move in zip(
                torch.autograd.grad(entry, parameters, retain_graph=True), moves, strict=True
            )
        )
        for entry in output.flatten()
    ]

    inputs, slopes = net.linearised(batch)
    weights = [value.detach() for value in parameters[::2]]
    moved = push_forward(inputs, slopes, weights, moves[::2], moves[1::2])
    of_weights, of_biases = pull_back(inputs, slopes, weights, cotangent)

    assert torch.allclose(moved, torch.stack(forward).view(7, 2), rtol=1e-12, atol=1e-12)
    ours = [part for pair in zip(of_weights, of_biases, strict=True) for part in pair]
    for part, expected in zip(ours, backward, strict=True):
        assert torch.allclose(part, expected, rtol=1e-12, atol=1e-12)


def test_the_passes_leave_what_they_are_given():
    net = RowwiseMLP(3, 2, (5,), nn.ReLU)
    inputs, slopes = net.linearised(torch.randn(7, 3))
    weights = [net[0].weight.detach(), net[2].weight.detach()]
    biases = [net[0].bias.detach(), net[2].bias.detach()]
    cotangent = torch.randn(7, 2)
    given = [*inputs, *slopes, *weights, *biases, cotangent]
    before = [value.clone() for value in given]
    push_forward(inputs, slopes, weights, weights, biases)
    pull_back(inputs, slopes, weights, cotangent)
    assert all(map(torch.equal, given, before))


def test_an_activation_whose_slope_is_not_known_is_refused():
    net = RowwiseMLP(3, 2, (5,), nn.SiLU)
    with pytest.raises(TypeError, match=r"slope of SiLU is not known; .*ReLU.*Tanh"):
        net.linearised(torch.randn(7, 3))
