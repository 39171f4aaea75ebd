"""The methods: the one place where the order of updates is decided."""

from pemirl_trl.methods.collection import EpisodeCollector
from pemirl_trl.methods.discriminator_batches import BatchConfig, DiscriminatorBatches
from pemirl_trl.methods.loop import TrainingDiverged, train
from pemirl_trl.methods.meta_il import MetaIL, MetaILConfig
from pemirl_trl.methods.pemirl import PEMIRL, PEMIRLConfig
from pemirl_trl.methods.policy_optimization import PolicyOptimization, PolicyOptimizationConfig
from pemirl_trl.methods.policy_step import PolicyStep, TRPOConfig

__all__ = [
    "PEMIRL",
    "BatchConfig",
    "DiscriminatorBatches",
    "EpisodeCollector",
    "MetaIL",
    "MetaILConfig",
    "PEMIRLConfig",
    "PolicyOptimization",
    "PolicyOptimizationConfig",
    "PolicyStep",
    "TRPOConfig",
    "TrainingDiverged",
    "train",
]
