"""What a caller gave where something else was meant: said in words, with the cure.

Components are put together by hand, in a script or in somebody's trainer. The mistakes that are
natural there (a data set for its trajectories, a reward for a discriminator, a batch without
contexts, a batch without time) end here, in one sentence, and not in a traceback of a library.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from tensordict import TensorDictBase, is_tensor_collection
from tensordict.nn import TensorDictModuleBase
from tensordict.utils import NestedKey
from torch import Tensor

_COLLECTION = "the policy writes it at collection: collect the rollouts with the policy itself"
_ENVIRONMENT = "rollouts of an environment and DemonstrationDataset.trajectories() hold it"
# Who writes what, by the role that a key plays; where a key has its default name, that is its role.
WRITERS: dict[NestedKey, str] = {
    "context": "InferContext writes it at reset, TransformedEnv(env, InferContext(encoder, "
    "demonstrations)); for stored trajectories draw it, encoder.get_dist(trajectories).rsample()",
    "loc": _COLLECTION,
    "scale": _COLLECTION,
    "logits": _COLLECTION,
    "action_log_prob": f"{_COLLECTION}; of expert transitions it is "
    "policy.get_dist(batch).log_prob(action)",
    "next_observation": _ENVIRONMENT,
    ("next", "observation"): _ENVIRONMENT,
    ("next", "reward"): "environments write it; a reward network alone can be called on the batch",
    "advantage": "FiniteHorizonAdvantage writes it: call it on the rollouts [N, T] first",
    "value_target": "FiniteHorizonAdvantage writes it: call it on the rollouts [N, T] first",
    "is_expert": "set it, True for the transitions of the expert",
}


class MissingKeyError(KeyError):
    """A batch lacks a key; unlike ``KeyError``'s, its message is readable."""

    def __str__(self) -> str:
        """Return the message as it was written, without quotes around it."""
        return str(self.args[0])


def missing_key(
    tensordict: TensorDictBase, key: NestedKey, reader: str, role: NestedKey | None = None
) -> MissingKeyError:
    """The error of a batch that lacks a key: what is there, and who writes what is not.

    Args:
        tensordict: the batch.
        key: what it lacks.
        reader: who reads it, the name of a class.
        role: what the key stands for, where its name does not say so.
    """
    present = sorted(map(str, tensordict.keys(True, True)))
    writer = WRITERS.get(key if role is None else role)
    cure = "" if writer is None else f". {writer[0].upper()}{writer[1:]}"
    return MissingKeyError(
        f"{reader} reads {key!r}, which this batch lacks; it has {', '.join(present)}{cure}"
    )


def read(
    tensordict: TensorDictBase, key: NestedKey, reader: str, role: NestedKey | None = None
) -> Tensor:
    """``tensordict[key]``, or an error that says who writes this key.

    Args:
        tensordict: a batch of any size.
        key: what to read.
        reader: who reads, the name of a class.
        role: what the key stands for, where its name does not say so.

    Raises:
        MissingKeyError: the batch lacks the key.
    """
    try:
        return tensordict[key]
    except KeyError:
        raise missing_key(tensordict, key, reader, role) from None


def trajectories_of(data: Any) -> Any:
    """The trajectories of a data set that has a method of this name; anything else as it is."""
    if is_tensor_collection(data) or not callable(getattr(data, "trajectories", None)):
        return data
    return data.trajectories()


def shown_of(trajectories: TensorDictBase) -> TensorDictBase:
    """What q sees in place of each trajectory: its entry ``shown``, or the trajectory itself.

    Another demonstration of the same task, by another body say: then m can hold nothing but what
    the two have in common.
    """
    shown = trajectories.get("shown", None)
    return trajectories if shown is None else shown


def acted_steps(batch: TensorDictBase) -> Tensor | None:
    """The steps ``[N, T]`` of trajectories whose action was somebody's choice; None: all of them.

    Not so padding (where ``mask`` is False), and what follows the end of an episode (where
    ``absorbing`` is True).
    """
    mask, absorbing = batch.get("mask", None), batch.get("absorbing", None)
    if absorbing is None:
        return mask
    return ~absorbing if mask is None else mask & ~absorbing


def key_of(module: TensorDictModuleBase, role: str) -> NestedKey:
    """Where a network reads what plays ``role``: its attribute ``<role>_key``, or the role's name.

    Raises:
        ValueError: the network reads no such key.
    """
    key = getattr(module, f"{role}_key", role)
    if key not in module.in_keys:
        raise ValueError(
            f"{type(module).__name__} reads {list(module.in_keys)}, and none of these is known to "
            f"be the {role}; give it the key {role!r}, or an attribute {role}_key that names it"
        )
    return key


def beside(context: Tensor, observation: Tensor) -> Tensor:
    """One context for many observations: ``[1, D]`` or ``[D]`` beside ``[..., S]`` as ``[..., D]``.

    Args:
        context: ``[D]``, or of as many dimensions as the observation, some of them of size 1.
        observation: ``[..., S]``.

    Raises:
        ValueError: the shapes do not fit. A context ``[N, D]`` is not taken for rollouts
            ``[N, T, S]``, since it could as well be meant for their T steps.
    """
    batch = observation.shape[:-1]
    if context.shape[:-1] == batch:
        return context
    fits = context.ndim == observation.ndim and all(
        size in (1, wanted) for size, wanted in zip(context.shape[:-1], batch, strict=True)
    )
    if context.ndim != 1 and not fits:
        raise ValueError(
            f"got contexts {list(context.shape)} beside observations {list(observation.shape)}; "
            f"expected {[*batch, context.shape[-1]]}, or size 1 where one context serves all: for "
            "one context per rollout, context.unsqueeze(1)"
        )
    return context.expand(*batch, context.shape[-1])


@dataclass(frozen=True)
class Part:
    """A kind of network that others are built from.

    Attributes:
        name: its name, with an article.
        attribute: under which a model or a discriminator holds such a part.
        choices: the classes of the library that are one.
        matches: whether a module is one. By what it can do, not by its class: others are welcome.
    """

    name: str
    attribute: str
    choices: str
    matches: Callable[[Any], bool]

    def required(self, value: Any, owner: str, cures: Sequence[tuple[type, str]] = ()) -> None:
        """Raise unless ``value`` is such a part.

        Args:
            value: what was given.
            owner: to whom, the name of a class.
            cures: what to do with an instance of some class.

        Raises:
            TypeError: it is none; the message says which classes are, and where one is at hand.
        """
        if self.matches(value):
            return
        cure = next((text for cls, text in cures if isinstance(value, cls)), None)
        if cure is None and self.matches(getattr(value, self.attribute, None)):
            cure = f"pass its .{self.attribute}"
        raise TypeError(
            f"{owner} takes {self.name} ({self.choices}), got {type(value).__name__}"
            + (f": {cure}" if cure else "")
        )


def _has(*names: str) -> Callable[[Any], bool]:
    return lambda value: all(hasattr(value, name) for name in names)


ENCODER = Part(
    "an encoder",
    "encoder",
    "ContextEncoder, AttentionContextEncoder, MaskedContextEncoder or NoContext",
    _has("get_dist", "context_dim"),
)
REWARD = Part(
    "a shaped reward", "reward", "ShapedReward", _has("potential", "reward_key", "context_key")
)
DISCRIMINATOR = Part(
    "a discriminator",
    "discriminator",
    "AIRLDiscriminator or GAILDiscriminator",
    _has("role_keys", "logit_key", "reward_key", "standardize"),
)
POLICY = Part(
    "a policy",
    "policy",
    "ContextPolicy, CategoricalPolicy or a ProbabilisticActor",
    # An encoder is a distribution too; what sets it apart is the context that it gives.
    lambda value: _has("build_dist_from_params")(value) and not hasattr(value, "context_dim"),
)
