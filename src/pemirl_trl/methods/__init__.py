"""The methods: the one place where the order of updates is decided."""

from pemirl_trl.methods.adaptation import AdaptationConfig, initial_policy
from pemirl_trl.methods.adversarial import AdaptiveSampler, AdversarialConfig, PolicyConfig
from pemirl_trl.methods.airl import AIRL, AIRLConfig
from pemirl_trl.methods.averaging import AveragedReward
from pemirl_trl.methods.best_trajectories import BestTrajectories
from pemirl_trl.methods.collection import EpisodeCollector
from pemirl_trl.methods.discriminator_batches import BatchConfig, DiscriminatorBatches
from pemirl_trl.methods.loop import TrainingDiverged, train
from pemirl_trl.methods.meta_il import MetaIL, MetaILConfig
from pemirl_trl.methods.meta_infogail import MetaInfoGAIL, MetaInfoGAILConfig
from pemirl_trl.methods.meta_training import METHODS, MethodConfig, build, new_model, start_from
from pemirl_trl.methods.pemirl import PEMIRL, PEMIRLConfig
from pemirl_trl.methods.policy_optimization import PolicyOptimization, PolicyOptimizationConfig
from pemirl_trl.methods.trpo import TRPO, TRPOConfig

__all__ = [
    "AIRL",
    "METHODS",
    "PEMIRL",
    "TRPO",
    "AIRLConfig",
    "AdaptationConfig",
    "AdaptiveSampler",
    "AdversarialConfig",
    "AveragedReward",
    "BatchConfig",
    "BestTrajectories",
    "DiscriminatorBatches",
    "EpisodeCollector",
    "MetaIL",
    "MetaILConfig",
    "MetaInfoGAIL",
    "MetaInfoGAILConfig",
    "MethodConfig",
    "PEMIRLConfig",
    "PolicyConfig",
    "PolicyOptimization",
    "PolicyOptimizationConfig",
    "TRPOConfig",
    "TrainingDiverged",
    "build",
    "initial_policy",
    "new_model",
    "start_from",
    "train",
]
