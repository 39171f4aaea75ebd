"""The trust-region step: conjugate gradient and line search on explicit parameters."""

from pemirl_trl.optim.conjugate_gradient import conjugate_gradient
from pemirl_trl.optim.routing import descend
from pemirl_trl.optim.trainer import TrustRegionStepper
from pemirl_trl.optim.trust_region import TrustRegionOptimizer, TrustRegionResult

__all__ = [
    "TrustRegionOptimizer",
    "TrustRegionResult",
    "TrustRegionStepper",
    "conjugate_gradient",
    "descend",
]
