"""Trust-region policy optimisation's step as an optimiser.

Source: Schulman, Levine, Moritz, Jordan and Abbeel (2015), "Trust Region Policy Optimization",
Section 6 and Appendix C.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector

from pemirl_trl.optim.conjugate_gradient import conjugate_gradient

Reason = Literal["accepted", "line_search_failed", "zero_gradient", "not_finite"]


@dataclass(frozen=True)
class TrustRegionResult:
    """What a step did.

    Attributes:
        accepted: whether the parameters changed.
        reason: why they did or did not.
        backtracks: how often the step was shrunk (all of them on failure).
        kl: mean KL(old || new) at the parameters that were kept, in nats.
        improvement: decrease of the loss at the parameters that were kept.
        expected_improvement: decrease that the linear model promised for the full step.
        cg_residual: relative residual of the conjugate gradient.
        gradient_norm: Euclidean norm of the gradient.
    """

    accepted: bool
    reason: Reason
    backtracks: int
    kl: float
    improvement: float
    expected_improvement: float
    cg_residual: float
    gradient_norm: float


class TrustRegionOptimizer:
    """Minimise a loss subject to mean KL(old || new) <= max_kl, by one natural-gradient step.

    The direction solves (F + damping I) x = -g by conjugate gradient, F being the Hessian of the
    KL at the old parameters (the Fisher information); the full step has length
    sqrt(2 max_kl / x'(F + damping I) x); a line search shrinks it until the KL bound holds and
    the loss falls by at least ``accept_ratio`` of what the linear model promises. If no step
    passes, the parameters are restored bit for bit.

    Args:
        params: the parameters to move, in place.
        max_kl: the trust region, in nats.
        cg_iterations: Fisher-vector products per step.
        damping: added to the Fisher information's diagonal.
        backtrack_ratio: each backtrack multiplies the step by this, in (0, 1).
        max_backtracks: how many tries the line search has.
        accept_ratio: fraction of the promised decrease to ask for; 0 asks for any decrease.
    """

    def __init__(
        self,
        params: Iterable[Tensor],
        *,
        max_kl: float = 0.01,
        cg_iterations: int = 10,
        damping: float = 1e-5,
        backtrack_ratio: float = 0.8,
        max_backtracks: int = 15,
        accept_ratio: float = 0.0,
    ) -> None:
        self.params: Sequence[Tensor] = [p for p in params if p.requires_grad]
        if not self.params:
            raise ValueError("got no parameter that requires a gradient")
        if max_kl <= 0 or damping < 0 or cg_iterations < 1 or max_backtracks < 1:
            raise ValueError(
                "expected max_kl > 0, damping >= 0, cg_iterations >= 1 and max_backtracks >= 1, "
                f"got {max_kl}, {damping}, {cg_iterations} and {max_backtracks}"
            )
        if not 0 < backtrack_ratio < 1:
            raise ValueError(f"expected backtrack_ratio in (0, 1), got {backtrack_ratio}")
        self.max_kl = max_kl
        self.cg_iterations = cg_iterations
        self.damping = damping
        self.backtrack_ratio = backtrack_ratio
        self.max_backtracks = max_backtracks
        self.accept_ratio = accept_ratio

    def step(
        self,
        closure: Callable[[], tuple[Tensor, Tensor]],
        fisher_closure: Callable[[], Tensor] | None = None,
    ) -> TrustRegionResult:
        """Take one step.

        Args:
            closure: () -> (loss, kl), two scalars at the current parameters; kl is measured
                from the distribution before the step, so it is zero at the first call.
            fisher_closure: () -> kl on fewer rows, for cheaper Fisher-vector products. By
                default the closure's.

        Returns:
            What happened.
        """
        with torch.enable_grad():
            loss, kl = closure()
            gradient = self._gradient(loss, retain_graph=fisher_closure is None)
            fisher_kl = kl if fisher_closure is None else fisher_closure()
            product = self._fisher_product(fisher_kl)
        norm = float(gradient.norm())
        if not torch.isfinite(gradient).all():
            return TrustRegionResult(False, "not_finite", 0, 0.0, 0.0, 0.0, 0.0, norm)
        if norm == 0.0:
            return TrustRegionResult(False, "zero_gradient", 0, 0.0, 0.0, 0.0, 0.0, norm)
        direction, residual = conjugate_gradient(product, -gradient, self.cg_iterations)
        curvature = direction @ product(direction)
        if not (torch.isfinite(curvature) and curvature > 0):
            return TrustRegionResult(False, "not_finite", 0, 0.0, 0.0, 0.0, residual, norm)
        full_step = direction * (2.0 * self.max_kl / curvature).sqrt()
        promised = float(-(gradient @ full_step))
        return self._line_search(closure, full_step, loss.detach(), promised, residual, norm)

    def _gradient(
        self, scalar: Tensor, *, retain_graph: bool = False, create_graph: bool = False
    ) -> Tensor:
        grads = torch.autograd.grad(
            scalar,
            self.params,
            retain_graph=retain_graph or create_graph,
            create_graph=create_graph,
            allow_unused=True,
        )
        return torch.cat(
            [
                (torch.zeros_like(p) if g is None else g).reshape(-1)
                for g, p in zip(grads, self.params, strict=True)
            ]
        )

    def _fisher_product(self, kl: Tensor) -> Callable[[Tensor], Tensor]:
        # One graph serves every product: rebuilding it costs more than the product itself.
        kl_gradient = self._gradient(kl, create_graph=True)

        def product(vector: Tensor) -> Tensor:
            image = self._gradient((kl_gradient * vector).sum(), retain_graph=True)
            return image.detach() + self.damping * vector

        return product

    def _assign(self, vector: Tensor) -> None:
        # In place, so that every holder of the parameters (losses, collectors) sees the step.
        sizes = [p.numel() for p in self.params]
        for parameter, values in zip(self.params, vector.split(sizes), strict=True):
            parameter.copy_(values.view_as(parameter))

    @torch.no_grad()
    def _line_search(
        self,
        closure: Callable[[], tuple[Tensor, Tensor]],
        full_step: Tensor,
        old_loss: Tensor,
        promised: float,
        residual: float,
        norm: float,
    ) -> TrustRegionResult:
        old = parameters_to_vector(self.params).clone()
        for backtracks in range(self.max_backtracks):
            ratio = self.backtrack_ratio**backtracks
            self._assign(old + ratio * full_step)
            loss, kl = closure()
            improvement = float(old_loss - loss)
            # Comparisons with NaN are false, so a step that breaks the loss is never accepted.
            if kl <= self.max_kl and improvement > self.accept_ratio * ratio * promised:
                return TrustRegionResult(
                    True, "accepted", backtracks, float(kl), improvement, promised, residual, norm
                )
        self._assign(old)
        return TrustRegionResult(
            False, "line_search_failed", self.max_backtracks, 0.0, 0.0, promised, residual, norm
        )
