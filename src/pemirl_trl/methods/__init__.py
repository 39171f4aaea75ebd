"""The methods: the one place where the order of updates is decided."""

from pemirl_trl.methods.adaptation import AdaptationConfig, initial_policy, objective
from pemirl_trl.methods.adversarial import AdaptiveSampler, AdversarialConfig, PolicyConfig
from pemirl_trl.methods.airl import AIRL, AIRLConfig
from pemirl_trl.methods.averaging import AveragedReward
from pemirl_trl.methods.best_trajectories import BestTrajectories
from pemirl_trl.methods.candidates import Candidate, candidates
from pemirl_trl.methods.collection import EpisodeCollector
from pemirl_trl.methods.defaults import PRESETS, adaptation_config, meta_training_config
from pemirl_trl.methods.diagnostics import Diagnostics
from pemirl_trl.methods.discriminator_batches import BatchConfig, DiscriminatorBatches
from pemirl_trl.methods.environments import MakeEnv, wrap_gymnasium
from pemirl_trl.methods.inference import Inference, infer
from pemirl_trl.methods.loop import TrainingDiverged, train
from pemirl_trl.methods.meta_il import MetaIL, MetaILConfig
from pemirl_trl.methods.meta_infogail import MetaInfoGAIL, MetaInfoGAILConfig
from pemirl_trl.methods.meta_training import METHODS, MethodConfig, build, new_model, start_from
from pemirl_trl.methods.own_adaptation import Adaptation, adapt, adapt_in_stages
from pemirl_trl.methods.own_training import meta_train, meta_train_in_stages, training_family
from pemirl_trl.methods.pemirl import PEMIRL, PEMIRLConfig
from pemirl_trl.methods.policy_optimization import PolicyOptimization, PolicyOptimizationConfig
from pemirl_trl.methods.task_space import TaskSpace, find_task_space
from pemirl_trl.methods.trpo import TRPO, TRPOConfig
from pemirl_trl.methods.worker_collection import WorkerCollector

__all__ = [
    "AIRL",
    "METHODS",
    "PEMIRL",
    "PRESETS",
    "TRPO",
    "AIRLConfig",
    "Adaptation",
    "AdaptationConfig",
    "AdaptiveSampler",
    "AdversarialConfig",
    "AveragedReward",
    "BatchConfig",
    "BestTrajectories",
    "Candidate",
    "Diagnostics",
    "DiscriminatorBatches",
    "EpisodeCollector",
    "Inference",
    "MakeEnv",
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
    "TaskSpace",
    "TrainingDiverged",
    "WorkerCollector",
    "adapt",
    "adapt_in_stages",
    "adaptation_config",
    "build",
    "candidates",
    "find_task_space",
    "infer",
    "initial_policy",
    "meta_train",
    "meta_train_in_stages",
    "meta_training_config",
    "new_model",
    "objective",
    "start_from",
    "train",
    "training_family",
    "wrap_gymnasium",
]
