"""The multilayer perceptron that every network is made of."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn
from torchrl.modules import MLP


def device_of(module: nn.Module) -> torch.device:
    """Where a network's weights are; the CPU for a module without any."""
    weights = next(module.parameters(), None)
    return torch.device("cpu") if weights is None else weights.device


class RowwiseMLP(MLP):
    """An MLP that sees any batch as rows, and whose ReLUs work in place.

    It takes ``[..., F]``, or several tensors that it puts one beside the other, and gives
    ``[..., out_features]``. Nothing else needs what goes into a ReLU, its own gradient included,
    and batches of thousands of rows spend more time on fresh memory than on arithmetic. A linear
    layer's output of more than two dimensions would be a view, on which working in place costs
    gradients a copy: hence the rows. Values and gradients are those of an MLP to the last bit.

    Args:
        in_features, out_features: sizes of input and output.
        hidden: widths of the hidden layers.
        activation: class of the non-linearity.
    """

    def __init__(
        self,
        in_features: int,
        out_features: int,
        hidden: Sequence[int],
        activation: type[nn.Module],
    ) -> None:
        super().__init__(
            in_features=in_features,
            out_features=out_features,
            num_cells=list(hidden),
            activation_class=activation,
            activation_kwargs={"inplace": True} if activation is nn.ReLU else None,
        )

    def forward(self, *inputs: Tensor) -> Tensor:
        """Map ``[..., F]``, in one tensor or in several, to ``[..., out_features]``."""
        (values,) = inputs if len(inputs) == 1 else (torch.cat(inputs, -1),)
        rows = super().forward(values.reshape(-1, values.shape[-1]))
        return rows.view(*values.shape[:-1], rows.shape[-1])

    @torch.no_grad()
    def linearised(self, *inputs: Tensor) -> tuple[list[Tensor], list[Tensor]]:
        """What the network's derivative at a batch is made of.

        Args:
            inputs: as of a call.

        Returns:
            The inputs of each linear layer, ``[B, F]``, and the slope of each activation. They hold
            for activations whose slope is a function of their value: ReLU and tanh.

        Raises:
            TypeError: another layer.
        """
        values = torch.cat(inputs, -1)
        values = values.reshape(-1, values.shape[-1])
        layer_inputs, slopes = [], []
        for layer in self:
            if isinstance(layer, nn.Linear):
                layer_inputs.append(values)
            values = layer(values)
            if isinstance(layer, nn.ReLU):
                slopes.append((values > 0).to(values.dtype))
            elif isinstance(layer, nn.Tanh):
                slopes.append(1.0 - values.square())
            elif not isinstance(layer, nn.Linear):
                raise TypeError(
                    f"the slope of {type(layer).__name__} is not known; ReLU's and Tanh's are"
                )
        return layer_inputs, slopes
