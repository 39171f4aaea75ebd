"""The trust-region step: conjugate gradient and line search on explicit parameters.

Its place in TorchRL's trainer is in :mod:`pemirl_trl.optim.trainer`, to be imported by name: the
import of ``torchrl.trainers`` raises a warning, which nobody else should get.
"""

from pemirl_trl.optim.conjugate_gradient import conjugate_gradient
from pemirl_trl.optim.routing import descend
from pemirl_trl.optim.trust_region import TrustRegionOptimizer, TrustRegionResult

__all__ = [
    "TrustRegionOptimizer",
    "TrustRegionResult",
    "conjugate_gradient",
    "descend",
]
