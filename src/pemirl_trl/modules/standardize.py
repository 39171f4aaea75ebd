"""One affine map of observations, shared by every network."""

from __future__ import annotations

from typing import Self

import torch
from torch import Tensor, nn


class Standardize(nn.Module):
    """The affine map (x - loc) / scale with fixed ``loc`` and ``scale``, saved with a model.

    Every network of a model holds the same map, so that networks take raw observations and
    gradients with respect to observations can be stated in standardised units.

    Args:
        loc, scale: ``[S]``, in the units of an observation; the scale is positive.

    Raises:
        ValueError: the shapes differ or are not ``[S]``, or a scale is not positive.

    Example:
        >>> import torch
        >>> heights = torch.tensor([[1.0, 10.0], [3.0, 30.0], [5.0, 50.0]])
        >>> standardize = Standardize.fit(heights)
        >>> standardize(heights)
        tensor([[-1., -1.],
                [ 0.,  0.],
                [ 1.,  1.]])
    """

    loc: Tensor
    scale: Tensor

    def __init__(self, loc: Tensor, scale: Tensor) -> None:
        super().__init__()
        if loc.shape != scale.shape or loc.ndim != 1:
            raise ValueError(
                f"expected loc and scale of one shape [features], got {tuple(loc.shape)} and "
                f"{tuple(scale.shape)}"
            )
        if not (scale > 0).all():
            raise ValueError(f"expected positive scales, got {scale.tolist()}")
        self.register_buffer("loc", loc.detach().clone())
        self.register_buffer("scale", scale.detach().clone())

    @classmethod
    def identity(cls, features: int) -> Self:
        """Return the map that changes nothing, for vectors of so many features."""
        return cls(torch.zeros(features), torch.ones(features))

    @classmethod
    def fit(cls, values: Tensor) -> Self:
        """Return the map to zero mean and unit deviation of ``values`` ``[..., S]``.

        Constants keep scale 1, and no scale is below a tenth of the median feature's. What hardly
        varies, such as the height of an object that lies on a table, would otherwise be noise of
        unit deviation, and hundreds of deviations off once the object falls over. The map is of
        torch's default dtype, whatever that of the values: so are the networks that share it.
        """
        rows = values.reshape(-1, values.shape[-1])
        dtype = torch.get_default_dtype()
        return cls(rows.mean(0).to(dtype), _scale(rows.std(0)).to(dtype))

    @classmethod
    def from_moments(cls, mean: Tensor, variance: Tensor) -> Self:
        """Return what :meth:`fit` would of data with this ``mean`` and ``variance`` ``[S]``."""
        dtype = torch.get_default_dtype()
        return cls(mean.to(dtype), _scale(variance.sqrt().to(dtype)))

    @property
    def features(self) -> int:
        """Dimension of the vectors it takes."""
        return self.loc.numel()

    def forward(self, values: Tensor) -> Tensor:
        """Map ``[..., S]`` to ``[..., S]``."""
        return (values - self.loc) / self.scale


def _scale(deviation: Tensor) -> Tensor:
    varies = deviation > 1e-6
    if not varies.any():
        return torch.ones_like(deviation)
    floor = 0.1 * deviation[varies].quantile(0.5)
    return torch.where(varies, deviation.clamp(min=floor), torch.ones_like(deviation))
