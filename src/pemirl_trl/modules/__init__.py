"""Networks of PEMIRL as TensorDict modules."""

from pemirl_trl.modules.actors import ContextPolicy, ContextValue
from pemirl_trl.modules.context_encoder import ContextEncoder, MaskedContextEncoder
from pemirl_trl.modules.discriminator import AIRLDiscriminator
from pemirl_trl.modules.model import ModelConfig, PEMIRLModel
from pemirl_trl.modules.reward import ShapedReward
from pemirl_trl.modules.standardize import Standardize

__all__ = [
    "AIRLDiscriminator",
    "ContextEncoder",
    "ContextPolicy",
    "ContextValue",
    "MaskedContextEncoder",
    "ModelConfig",
    "PEMIRLModel",
    "ShapedReward",
    "Standardize",
]
