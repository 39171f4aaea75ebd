"""Meta-IL: imitation with latent contexts, no environment needed; it also initialises q_psi."""

from __future__ import annotations

from typing import Any

import torch
from pydantic.dataclasses import dataclass
from tensordict import TensorDictBase
from torch.optim import Adam

from pemirl_trl.configuration import CHECKED, Count, NonNegative
from pemirl_trl.methods.loop import iteration_count
from pemirl_trl.modules import PEMIRLModel
from pemirl_trl.modules.network import device_of
from pemirl_trl.objectives import MetaILLoss
from pemirl_trl.optim import descend


@dataclass(frozen=True, config=CHECKED)
class MetaILConfig:
    """Of the imitation.

    Attributes:
        steps: Adam steps in all, a multiple of ``steps_per_iteration``.
        steps_per_iteration: how many of them one iteration does.
        batch_size: demonstrations per step.
        lr: of Adam.
        kl_coeff: weight of KL(q || N(0, I)) per trajectory; at the 0.1 of the authors' code
            one-shot imitation of Point-Maze learns far slower.
    """

    steps: Count = 3000
    steps_per_iteration: Count = 100
    batch_size: Count = 64
    lr: NonNegative = 1e-3
    kl_coeff: NonNegative = 0.03

    def __post_init__(self) -> None:
        iteration_count(self.steps, self.steps_per_iteration)


class MetaIL:
    """Maximise the evidence bound of the demonstrations in psi and omega.

    Args:
        model: its encoder and policy are trained in place.
        demonstrations: batch size ``[J]``, leaves ``[J, T, ...]``; unlabelled.
        config: of the training.
    """

    def __init__(
        self, model: PEMIRLModel, demonstrations: TensorDictBase, config: MetaILConfig
    ) -> None:
        self.config, self.model = config, model
        self.demonstrations = demonstrations.to(device_of(model))
        self.iterations = iteration_count(config.steps, config.steps_per_iteration)
        self.env_steps = 0
        self.loss = MetaILLoss(model.encoder, model.policy, kl_coeff=config.kl_coeff)
        self.optimizer = Adam(
            [*model.encoder.parameters(), *model.policy.parameters()], lr=config.lr
        )

    def iteration(self) -> dict[str, float]:
        """So many Adam steps; the metrics are means over them."""
        total: dict[str, float] = {}
        for _ in range(self.config.steps_per_iteration):
            index = torch.randint(self.demonstrations.batch_size[0], (self.config.batch_size,))
            losses = self.loss(self.demonstrations[index])
            descend(self.optimizer, losses["loss_imitation"] + losses["loss_kl"])
            for name in ("loss_imitation", "kl"):
                total[name] = total.get(name, 0.0) + float(losses[name].detach())
        return {f"meta_il/{k}": v / self.config.steps_per_iteration for k, v in total.items()}

    def components(self) -> dict[str, Any]:
        """What a checkpoint holds."""
        return {
            "encoder": self.model.encoder,
            "policy": self.model.policy,
            "optimizer": self.optimizer,
        }
