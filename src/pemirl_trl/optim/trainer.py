"""The trust-region step in TorchRL's trainer."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.trainers import OptimizationStepper

from pemirl_trl.optim.trust_region import TrustRegionOptimizer

if TYPE_CHECKING:
    from torchrl.trainers import Trainer


class TrustRegionStepper(OptimizationStepper):
    """One trust-region step per batch of a ``torchrl.trainers.Trainer``.

    A trainer's own step descends the sum of all losses; a trust region needs the loss and its
    constraint apart, and both of them anew along the line search. The batch is whole: leave
    ``optim_steps_per_batch`` at 1 and give advantages before it.

    Logs what the loss gives before the step, and of the step's result ``trust_region/accepted``
    (0 or 1), ``trust_region/kl`` in nats, ``trust_region/backtracks`` and
    ``trust_region/improvement``.

    Args:
        objective_key: which output of the trainer's loss is to fall.
        constraint_key: which is the KL.

    Example:
        A trainer is made of parts that this example leaves to you::

            from pemirl_trl.optim.trainer import TrustRegionStepper

            policy_loss = TRPOLoss(policy)
            trainer = Trainer(
                collector=collector,  # of env and policy, whole episodes per batch
                total_frames=100_000,
                frame_skip=1,
                optim_steps_per_batch=1,
                loss_module=policy_loss,
                optimizer=TrustRegionOptimizer(policy.parameters(), max_kl=0.02),
                optimization_stepper=TrustRegionStepper(),
            )
            trainer.register_op("batch_process", FiniteHorizonAdvantage())
            trainer.train()
    """

    def __init__(self, objective_key: str = "loss_objective", constraint_key: str = "kl") -> None:
        self.objective_key, self.constraint_key = objective_key, constraint_key

    def step(self, trainer: Trainer, sub_batch: TensorDictBase) -> TensorDict:
        """Take one step on a batch and return what is to be logged.

        Raises:
            TypeError: the trainer's optimiser is no :class:`pemirl_trl.TrustRegionOptimizer`.
            KeyError: its loss does not give the objective or the constraint.
        """
        optimizer = trainer.optimizer
        if not isinstance(optimizer, TrustRegionOptimizer):
            raise TypeError(
                "TrustRegionStepper needs a trainer with optimizer=TrustRegionOptimizer(...), got "
                f"{type(optimizer).__name__}"
            )
        before: list[TensorDictBase] = []

        def closure() -> tuple[Tensor, Tensor]:
            losses = trainer.compute_loss(sub_batch)
            if not before:
                before.append(losses.detach())
            return losses[self.objective_key], losses[self.constraint_key]

        result = optimizer.step(closure)
        logged = {
            "trust_region/accepted": torch.tensor(float(result.accepted)),
            "trust_region/kl": torch.tensor(result.kl),
            "trust_region/backtracks": torch.tensor(float(result.backtracks)),
            "trust_region/improvement": torch.tensor(result.improvement),
        }
        return TensorDict({**before[0], **logged})
