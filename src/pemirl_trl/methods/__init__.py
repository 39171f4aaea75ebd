"""The methods: the one place where the order of updates is decided."""

from pemirl_trl.methods.airl import AIRL, AIRLConfig
from pemirl_trl.methods.averaging import AveragedReward
from pemirl_trl.methods.best_trajectories import BestTrajectories
from pemirl_trl.methods.collection import EpisodeCollector
from pemirl_trl.methods.discriminator_batches import BatchConfig, DiscriminatorBatches
from pemirl_trl.methods.loop import TrainingDiverged, train
from pemirl_trl.methods.meta_il import MetaIL, MetaILConfig
from pemirl_trl.methods.meta_infogail import MetaInfoGAIL, MetaInfoGAILConfig
from pemirl_trl.methods.pemirl import PEMIRL, PEMIRLConfig
from pemirl_trl.methods.policy_improvement import PolicyConfig, PolicyImprovement
from pemirl_trl.methods.policy_optimization import PolicyOptimization, PolicyOptimizationConfig
from pemirl_trl.methods.policy_step import PolicyStep, TRPOConfig

__all__ = [
    "AIRL",
    "PEMIRL",
    "AIRLConfig",
    "AveragedReward",
    "BatchConfig",
    "BestTrajectories",
    "DiscriminatorBatches",
    "EpisodeCollector",
    "MetaIL",
    "MetaILConfig",
    "MetaInfoGAIL",
    "MetaInfoGAILConfig",
    "PEMIRLConfig",
    "PolicyConfig",
    "PolicyImprovement",
    "PolicyOptimization",
    "PolicyOptimizationConfig",
    "PolicyStep",
    "TRPOConfig",
    "TrainingDiverged",
    "train",
]
