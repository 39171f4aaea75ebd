"""The multilayer perceptron of every network: an MLP to the last bit, without its copies."""

import pytest
import torch
from torch import Tensor, nn
from torchrl.modules import MLP

from pemirl_trl.modules.network import RowwiseMLP


def _pair(activation: type[nn.Module] = nn.ReLU) -> tuple[RowwiseMLP, MLP]:
    rowwise = RowwiseMLP(5, 2, (16, 16), activation)
    plain = MLP(in_features=5, out_features=2, num_cells=[16, 16], activation_class=activation)
    plain.load_state_dict(rowwise.state_dict())
    return rowwise, plain


def _gradients(net: nn.Module, *inputs: Tensor) -> tuple[Tensor, ...]:
    """Of the output in the weights, and of the input's squared slope: a penalty's."""
    values = [x.clone().requires_grad_() for x in inputs]
    out = net(*values)
    slope = torch.autograd.grad(out.sum(), values, create_graph=True)
    penalty = sum(s.square().sum() for s in slope)
    return torch.autograd.grad(out.square().mean() + penalty, [*net.parameters()])


@pytest.mark.parametrize("activation", [nn.ReLU, nn.Tanh])
@pytest.mark.parametrize("shape", [(7,), (3, 4), (2, 3, 4)])
def test_values_and_gradients_are_an_mlps_to_the_last_bit(
    activation: type[nn.Module], shape: tuple[int, ...]
) -> None:
    rowwise, plain = _pair(activation)
    states, context = torch.randn(*shape, 3), torch.randn(*shape, 2)
    assert torch.equal(rowwise(states, context), plain(states, context))
    for ours, theirs in zip(
        _gradients(rowwise, states, context), _gradients(plain, states, context), strict=True
    ):
        assert torch.equal(ours, theirs)


def test_what_it_is_given_stays_as_it_was() -> None:
    rowwise, _ = _pair()
    values = torch.randn(3, 4, 5)
    kept = values.clone()
    rowwise(values)
    assert torch.equal(values, kept)


def test_relu_works_in_place_and_not_on_a_view() -> None:
    """On a view, gradients would be copied, which costs more than is gained."""
    rowwise, _ = _pair()
    seen = []
    hooks = [
        layer.register_forward_hook(lambda _, inputs, out: seen.append((inputs[0], out)))
        for layer in rowwise
        if isinstance(layer, nn.ReLU)
    ]
    rowwise(torch.randn(3, 4, 5))
    assert len(hooks) == len(seen) == 2
    for given, out in seen:
        assert given is out
        assert not out._is_view()


def test_a_single_vector_and_no_rows_pass() -> None:
    rowwise, plain = _pair()
    one = torch.randn(5)
    torch.testing.assert_close(rowwise(one), plain(one))
    assert rowwise(torch.empty(0, 4, 5)).shape == (0, 4, 2)
