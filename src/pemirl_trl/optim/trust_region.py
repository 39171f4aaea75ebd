"""Trust-region policy optimisation's step as an optimiser.

Source: Schulman, Levine, Moritz, Jordan and Abbeel (2015), "Trust Region Policy Optimization",
arXiv:1502.05477, Section 6 and Appendix C.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Literal

import torch
from torch import Tensor
from torch.nn.utils import parameters_to_vector
from torch.optim import Optimizer

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


class TrustRegionOptimizer(Optimizer):
    """Minimise a loss subject to mean KL(old || new) <= max_kl, by one natural-gradient step.

    The direction solves (F + damping I) x = -g by conjugate gradient, F being the Hessian of the
    KL at the old parameters (the Fisher information); the full step has length
    sqrt(2 max_kl / x'(F + damping I) x); a line search shrinks it until the KL bound holds and
    the loss falls by at least ``accept_ratio`` of what the linear model promises. If no step
    passes, the parameters are restored bit for bit.

    It is a ``torch.optim.Optimizer`` with one parameter group, which holds the settings below and
    where a schedule may change them. It keeps no state between steps. In TorchRL's ``Trainer`` it
    stands with a :class:`pemirl_trl.optim.trainer.TrustRegionStepper`.

    Args:
        params: the parameters to move, in place; those that require no gradient stay.
        max_kl: the trust region, in nats.
        cg_iterations: Fisher-vector products per step.
        damping: added to the Fisher information's diagonal.
        backtrack_ratio: each backtrack multiplies the step by this, in (0, 1).
        max_backtracks: how many tries the line search has.
        accept_ratio: fraction of the promised decrease to ask for; 0 asks for any decrease.

    Raises:
        ValueError: nothing to move, more than one parameter group, or a senseless setting.

    Example:
        >>> x = torch.nn.Parameter(torch.zeros(2))
        >>> def closure():
        ...     return x.sum(), 0.5 * x.square().sum()  # the loss, and a KL that is 0 at first
        >>> optimizer = TrustRegionOptimizer([x], max_kl=0.01)
        >>> result = optimizer.step(closure)
        >>> result.accepted, [round(value, 3) for value in x.tolist()]
        (True, [-0.1, -0.1])
    """

    def __init__(
        self,
        params: Iterable[Any],
        *,
        max_kl: float = 0.01,
        cg_iterations: int = 10,
        damping: float = 1e-5,
        backtrack_ratio: float = 0.8,
        max_backtracks: int = 15,
        accept_ratio: float = 0.0,
    ) -> None:
        settings = {
            "max_kl": max_kl,
            "cg_iterations": cg_iterations,
            "damping": damping,
            "backtrack_ratio": backtrack_ratio,
            "max_backtracks": max_backtracks,
            "accept_ratio": accept_ratio,
        }
        super().__init__(params, settings)

    def add_param_group(self, param_group: dict[str, Any]) -> None:
        """Add the one group of parameters; called by the constructor.

        Raises:
            ValueError: it is the second one, or holds nothing to move.
        """
        if self.param_groups:
            raise ValueError(
                "expected one parameter group, got a second one: a step has one trust region, in "
                "which all parameters move together"
            )
        super().add_param_group(param_group)
        group = self.param_groups[0]
        moves = [p.requires_grad for p in group["params"]]
        for entry in {"params", "param_names"} & set(group):
            group[entry] = [v for v, kept in zip(group[entry], moves, strict=True) if kept]
        if not group["params"]:
            raise ValueError("got no parameter that requires a gradient")
        _check(group)

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Take the settings of another optimiser of as many parameters.

        Raises:
            ValueError: another number of parameters, or a senseless setting.
        """
        _check(state_dict["param_groups"][0])
        super().load_state_dict(state_dict)

    @property
    def _settings(self) -> dict[str, Any]:
        return self.param_groups[0]

    @property
    def _params(self) -> list[Tensor]:
        return self.param_groups[0]["params"]

    def step(  # type: ignore[override]  # torch's closures return a loss alone, and so its steps
        self,
        closure: Callable[[], tuple[Tensor, Tensor]],
        fisher_closure: Callable[[], Tensor] | None = None,
        fisher_product: Callable[[Tensor], Tensor] | None = None,
    ) -> TrustRegionResult:
        """Take one step.

        Args:
            closure: () -> (loss, kl), two scalars at the current parameters; kl is measured
                from the distribution before the step, so it is zero at the first call.
            fisher_closure: () -> kl on fewer rows, for cheaper Fisher-vector products. By
                default the closure's.
            fisher_product: v -> F v without damping, for vectors ``[P]`` of all parameters in
                their order, where it is known in closed form. By default a kl is differentiated
                twice.

        Returns:
            What happened.

        Raises:
            TypeError: the closure returns something else.
            ValueError: loss or kl carries no gradient, or both ways to F are given.
        """
        if fisher_closure is not None and fisher_product is not None:
            raise ValueError("got fisher_closure and fisher_product; expected one way to F")
        with torch.enable_grad():
            loss, kl = _loss_and_kl(closure)
            _require_gradient(loss, "loss")
            _require_gradient(kl, "kl")
            own = fisher_closure is None and fisher_product is None
            gradient = self._gradient(loss, retain_graph=own)
            if fisher_closure is not None:
                kl = fisher_closure()
                _require_gradient(kl, "kl of the fisher_closure")
            product = self._damped(fisher_product or self._fisher_product(kl))
        norm = float(gradient.norm())
        if not torch.isfinite(gradient).all():
            return TrustRegionResult(False, "not_finite", 0, 0.0, 0.0, 0.0, 0.0, norm)
        if norm == 0.0:
            return TrustRegionResult(False, "zero_gradient", 0, 0.0, 0.0, 0.0, 0.0, norm)
        direction, residual = conjugate_gradient(
            product, -gradient, self._settings["cg_iterations"]
        )
        curvature = direction @ product(direction)
        if not (torch.isfinite(curvature) and curvature > 0):
            return TrustRegionResult(False, "not_finite", 0, 0.0, 0.0, 0.0, residual, norm)
        full_step = direction * (2.0 * self._settings["max_kl"] / curvature).sqrt()
        promised = float(-(gradient @ full_step))
        return self._line_search(closure, full_step, loss.detach(), promised, residual, norm)

    def _gradient(
        self, scalar: Tensor, *, retain_graph: bool = False, create_graph: bool = False
    ) -> Tensor:
        grads = torch.autograd.grad(
            scalar,
            self._params,
            retain_graph=retain_graph or create_graph,
            create_graph=create_graph,
            allow_unused=True,
        )
        return torch.cat(
            [
                (torch.zeros_like(p) if g is None else g).reshape(-1)
                for g, p in zip(grads, self._params, strict=True)
            ]
        )

    def _fisher_product(self, kl: Tensor) -> Callable[[Tensor], Tensor]:
        # One graph serves every product: rebuilding it costs more than the product itself.
        kl_gradient = self._gradient(kl, create_graph=True)

        def product(vector: Tensor) -> Tensor:
            return self._gradient((kl_gradient * vector).sum(), retain_graph=True).detach()

        return product

    def _damped(self, product: Callable[[Tensor], Tensor]) -> Callable[[Tensor], Tensor]:
        damping = self._settings["damping"]
        return lambda vector: product(vector) + damping * vector

    def _assign(self, vector: Tensor) -> None:
        # In place, so that every holder of the parameters (losses, collectors) sees the step.
        sizes = [p.numel() for p in self._params]
        for parameter, values in zip(self._params, vector.split(sizes), strict=True):
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
        settings = self._settings
        max_kl, accept_ratio = settings["max_kl"], settings["accept_ratio"]
        old = parameters_to_vector(self._params).clone()
        for backtracks in range(settings["max_backtracks"]):
            ratio = settings["backtrack_ratio"] ** backtracks
            self._assign(old + ratio * full_step)
            loss, kl = _loss_and_kl(closure)
            improvement = float(old_loss - loss)
            # Comparisons with NaN are false, so a step that breaks the loss is never accepted.
            if kl <= max_kl and improvement > accept_ratio * ratio * promised:
                return TrustRegionResult(
                    True, "accepted", backtracks, float(kl), improvement, promised, residual, norm
                )
        self._assign(old)
        tried = settings["max_backtracks"]
        return TrustRegionResult(
            False, "line_search_failed", tried, 0.0, 0.0, promised, residual, norm
        )


def _check(group: dict[str, Any]) -> None:
    names = ("max_kl", "damping", "cg_iterations", "max_backtracks")
    max_kl, damping, cg_iterations, max_backtracks = (group[name] for name in names)
    if max_kl <= 0 or damping < 0 or cg_iterations < 1 or max_backtracks < 1:
        raise ValueError(
            "expected max_kl > 0, damping >= 0, cg_iterations >= 1 and max_backtracks >= 1, "
            f"got {max_kl}, {damping}, {cg_iterations} and {max_backtracks}"
        )
    ratio = group["backtrack_ratio"]
    if not 0 < ratio < 1:
        raise ValueError(f"expected backtrack_ratio in (0, 1), got {ratio}")


def _loss_and_kl(closure: Callable[[], tuple[Tensor, Tensor]]) -> tuple[Tensor, Tensor]:
    result = closure()
    if isinstance(result, tuple) and len(result) == 2:
        loss, kl = result
        if all(isinstance(value, Tensor) and value.numel() == 1 for value in (loss, kl)):
            return loss, kl
    raise TypeError(
        f"the closure returned {_described(result)}; expected (loss, kl), two scalar tensors: with "
        'losses = TRPOLoss(policy)(batch), return losses["loss_objective"], losses["kl"]'
    )


def _described(value: object) -> str:
    if isinstance(value, Tensor):
        return f"a tensor of shape {list(value.shape)}"
    if isinstance(value, tuple):
        return f"({', '.join(_described(item) for item in value)})"
    return f"a {type(value).__name__}"


def _require_gradient(value: Tensor, name: str) -> None:
    if not value.requires_grad:
        raise ValueError(
            f"the {name} carries no gradient; expected a function of the parameters: do not detach "
            "it, nor compute it under torch.no_grad()"
        )
