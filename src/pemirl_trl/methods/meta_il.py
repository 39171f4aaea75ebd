"""Meta-IL: imitation with latent contexts, no environment needed; it also initialises q_psi."""

from __future__ import annotations

from typing import Any, Literal

import torch
from pydantic.dataclasses import dataclass
from tensordict import TensorDictBase
from torch.optim import Adam
from torch.optim.lr_scheduler import CosineAnnealingLR

from pemirl_trl.configuration import CHECKED, Count, NonNegative, Share
from pemirl_trl.data import in_parts
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
        lr: of Adam, at the start.
        lr_schedule: it stays there, or falls to 0 along half a cosine.
        kl_coeff: weight of KL(q || N(0, I)) per trajectory; at the 0.1 of the authors' code
            one-shot imitation of Point-Maze learns far slower.
        part_share: of the demonstrations of a step, those of which q sees one part and the policy
            imitates the other (:func:`pemirl_trl.data.in_parts`); the paper: none.
    """

    steps: Count = 3000
    steps_per_iteration: Count = 100
    batch_size: Count = 64
    lr: NonNegative = 1e-3
    lr_schedule: Literal["constant", "cosine"] = "constant"
    kl_coeff: NonNegative = 0.03
    part_share: Share = 0.0

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
        cosine = config.lr_schedule == "cosine"
        self.schedule = CosineAnnealingLR(self.optimizer, config.steps) if cosine else None

    def iteration(self) -> dict[str, float]:
        """So many Adam steps; the metrics are means over them."""
        total: dict[str, float] = {}
        for _ in range(self.config.steps_per_iteration):
            index = torch.randint(self.demonstrations.batch_size[0], (self.config.batch_size,))
            losses = self.loss(self._as_shown(self.demonstrations[index]))
            descend(self.optimizer, losses["loss_imitation"] + losses["loss_kl"])
            if self.schedule is not None:
                self.schedule.step()
            for name in ("loss_imitation", "kl"):
                total[name] = total.get(name, 0.0) + float(losses[name].detach())
        return {f"meta_il/{k}": v / self.config.steps_per_iteration for k, v in total.items()}

    def _as_shown(self, batch: TensorDictBase) -> TensorDictBase:
        """Some of the batch in parts; not where q sees another demonstration of the task."""
        share = self.config.part_share
        if share == 0.0 or "shown" in batch:
            return batch
        masked = hasattr(self.model.encoder, "mask_key")
        return in_parts(batch, share, None if masked else self.model.standardize.loc)

    def components(self) -> dict[str, Any]:
        """What a checkpoint holds."""
        return {
            "encoder": self.model.encoder,
            "policy": self.model.policy,
            "optimizer": self.optimizer,
            **({} if self.schedule is None else {"schedule": self.schedule}),
        }
