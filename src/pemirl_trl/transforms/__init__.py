"""Transforms for TorchRL environments and stored batches."""

from pemirl_trl.transforms.absorbing import AbsorbingState
from pemirl_trl.transforms.actions import OneHotActions
from pemirl_trl.transforms.body import TellBody
from pemirl_trl.transforms.context import InferContext
from pemirl_trl.transforms.learned_reward import LearnedReward
from pemirl_trl.transforms.observations import JoinObservations
from pemirl_trl.transforms.tasks import SampleTasks

__all__ = [
    "AbsorbingState",
    "InferContext",
    "JoinObservations",
    "LearnedReward",
    "OneHotActions",
    "SampleTasks",
    "TellBody",
]
