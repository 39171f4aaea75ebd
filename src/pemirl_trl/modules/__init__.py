"""Networks of PEMIRL as TensorDict modules."""

from pemirl_trl.modules.action_cost import ActionCost
from pemirl_trl.modules.actors import ContextPolicy, ContextValue
from pemirl_trl.modules.attention_encoder import AttentionContextEncoder
from pemirl_trl.modules.categorical import CategoricalPolicy
from pemirl_trl.modules.context_encoder import ContextEncoder, MaskedContextEncoder, NoContext
from pemirl_trl.modules.discriminator import AIRLDiscriminator, GAILDiscriminator
from pemirl_trl.modules.family import FamilyDistance, TrainingFamily
from pemirl_trl.modules.model import ModelConfig, PEMIRLModel
from pemirl_trl.modules.reading import MissingKeyError
from pemirl_trl.modules.reward import ShapedReward
from pemirl_trl.modules.standardize import Standardize

__all__ = [
    "AIRLDiscriminator",
    "ActionCost",
    "AttentionContextEncoder",
    "CategoricalPolicy",
    "ContextEncoder",
    "ContextPolicy",
    "ContextValue",
    "FamilyDistance",
    "GAILDiscriminator",
    "MaskedContextEncoder",
    "MissingKeyError",
    "ModelConfig",
    "NoContext",
    "PEMIRLModel",
    "ShapedReward",
    "Standardize",
    "TrainingFamily",
]
