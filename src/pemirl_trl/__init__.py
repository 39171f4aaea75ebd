"""Meta inverse RL from unlabelled demonstrations, as TorchRL components.

PEMIRL (Yu, Yu, Finn and Ermon, NeurIPS 2019) meta-learns an inference model q(m | demonstration)
and a reward r(s, m). One table of all keys, with N = M K rollouts of T steps (M contexts, K
rollouts each, context-major):

======================== =========== ============ =============================================
key                      shape       symbol       written by
======================== =========== ============ =============================================
observation              [N, T, S]   s_t          the environment; never holds the task
action                   [N, T, A]   a_t          the policy; as drawn, before any clipping; a
                                                  discrete one is one-hot, of A choices
("next", "observation")  [N, T, S]   s_{t+1}      the environment
context                  [N, T, D]   m            InferContext, once per rollout
context_loc              [N, D]      mean of q    ContextEncoder
context_scale            [N, D]      deviation    ContextEncoder
demonstration            [N, T]      index        InferContext: which demonstration m is from
mask                     [N, T]                   demonstrations: False for padding, if there is any
absorbing                [N, T]                   AbsorbingState: the episode ended before this step
loc, scale               [N, T, A]                ContextPolicy: parameters of pi at collection
logits                   [N, T, A]                CategoricalPolicy: the same
action_log_prob          [N, T]      log pi       the policy, at collection
learned_reward           [..., 1]    r_theta      ShapedReward
shaped_reward            [..., 1]    f            ShapedReward: r + gamma h' - h
logit_expert             [..., 1]    f - log pi   AIRLDiscriminator; high means expert
("next", "reward")       [N, T, 1]   r            the environment, or LearnedReward in its place
("next", "true_reward")  [N, T, 1]                LearnedReward: the environment's own, a metric
advantage, value_target  [N, T, 1]                FiniteHorizonAdvantage
("task", ...)            [N, T, ..]               ground truth; metrics may read it, no learner does
loss_*                   []                       every loss; its other outputs are detached,
                                                  but for the constraint ``kl`` of TRPOLoss
======================== =========== ============ =============================================
"""

import importlib
from typing import TYPE_CHECKING, Any

from pemirl_trl.data import DemonstrationDataset, Negatives, Provenance
from pemirl_trl.files import Card
from pemirl_trl.health import Finding, Health, Sign
from pemirl_trl.modules import (
    AIRLDiscriminator,
    AttentionContextEncoder,
    CategoricalPolicy,
    ContextEncoder,
    ContextPolicy,
    ContextValue,
    FamilyDistance,
    GAILDiscriminator,
    MaskedContextEncoder,
    ModelConfig,
    NoContext,
    PEMIRLModel,
    ShapedReward,
    Standardize,
    TrainingFamily,
)
from pemirl_trl.objectives import (
    DiscriminatorLoss,
    FiniteHorizonAdvantage,
    InfoLoss,
    MetaILLoss,
    TRPOLoss,
    ValueLoss,
)
from pemirl_trl.optim import TrustRegionOptimizer, TrustRegionResult
from pemirl_trl.pretrained import load_card, load_model, save_model
from pemirl_trl.sharing import (
    PortableReward,
    load_policy,
    load_reward,
    save_policy,
    save_reward,
)
from pemirl_trl.transforms import (
    AbsorbingState,
    InferContext,
    JoinObservations,
    LearnedReward,
    OneHotActions,
    SampleTasks,
    TellBody,
)

if TYPE_CHECKING:
    from pemirl_trl.adapters import (
        AbsorbingStateWrapper,
        BatchReward,
        LearnedRewardVectorWrapper,
        LearnedRewardWrapper,
    )
    from pemirl_trl.methods import (
        Adaptation,
        Inference,
        TaskSpace,
        adapt,
        find_task_space,
        infer,
        meta_train,
        wrap_gymnasium,
    )

__version__ = "0.1.0"

__all__ = [
    "AIRLDiscriminator",
    "AbsorbingState",
    "AbsorbingStateWrapper",
    "Adaptation",
    "AttentionContextEncoder",
    "BatchReward",
    "Card",
    "CategoricalPolicy",
    "ContextEncoder",
    "ContextPolicy",
    "ContextValue",
    "DemonstrationDataset",
    "DiscriminatorLoss",
    "FamilyDistance",
    "Finding",
    "FiniteHorizonAdvantage",
    "GAILDiscriminator",
    "Health",
    "InferContext",
    "Inference",
    "InfoLoss",
    "JoinObservations",
    "LearnedReward",
    "LearnedRewardVectorWrapper",
    "LearnedRewardWrapper",
    "MaskedContextEncoder",
    "MetaILLoss",
    "ModelConfig",
    "Negatives",
    "NoContext",
    "OneHotActions",
    "PEMIRLModel",
    "PortableReward",
    "Provenance",
    "SampleTasks",
    "ShapedReward",
    "Sign",
    "Standardize",
    "TRPOLoss",
    "TaskSpace",
    "TellBody",
    "TrainingFamily",
    "TrustRegionOptimizer",
    "TrustRegionResult",
    "ValueLoss",
    "adapt",
    "find_task_space",
    "infer",
    "load_card",
    "load_model",
    "load_policy",
    "load_reward",
    "meta_train",
    "save_model",
    "save_policy",
    "save_reward",
    "wrap_gymnasium",
]

# These bring TorchRL's collectors, which warn of their own deprecated classes at import: whoever
# composes losses in a trainer of theirs has no need of them.
_CALLS = {
    **dict.fromkeys(
        (
            "Adaptation",
            "Inference",
            "TaskSpace",
            "adapt",
            "find_task_space",
            "infer",
            "meta_train",
            "wrap_gymnasium",
        ),
        "pemirl_trl.methods",
    ),
    **dict.fromkeys(
        (
            "AbsorbingStateWrapper",
            "BatchReward",
            "LearnedRewardVectorWrapper",
            "LearnedRewardWrapper",
        ),
        "pemirl_trl.adapters",
    ),
}


def __getattr__(name: str) -> Any:
    """Import the calls for a task of one's own when they are asked for (PEP 562)."""
    if name in _CALLS:
        return getattr(importlib.import_module(_CALLS[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
