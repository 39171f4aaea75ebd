"""Losses: they read keys, call pure functions, and return ``loss_*`` and detached metrics."""

from pemirl_trl.objectives.discriminator import DiscriminatorLoss
from pemirl_trl.objectives.info import InfoLoss
from pemirl_trl.objectives.meta_il import MetaILLoss
from pemirl_trl.objectives.trpo import TRPOLoss
from pemirl_trl.objectives.value import FiniteHorizonAdvantage, ValueLoss

__all__ = [
    "DiscriminatorLoss",
    "FiniteHorizonAdvantage",
    "InfoLoss",
    "MetaILLoss",
    "TRPOLoss",
    "ValueLoss",
]
