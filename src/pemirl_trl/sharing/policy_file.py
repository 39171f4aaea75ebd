"""One file that holds an adapted policy. It reads contexts, which its model infers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from pemirl_trl.files import load_weights, read_metadata, save_weights
from pemirl_trl.modules import PEMIRLModel
from pemirl_trl.modules.model import Policy


def save_policy(
    path: str | Path,
    policy: Policy,
    activation: str,
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Write a policy, the activation of its hidden layers, and ``metadata``, atomically.

    Raises:
        OSError: it cannot be written; the message names the file and says what to do.
    """
    save_weights(path, {"policy": policy}, {**(metadata or {}), "activation": activation})


def load_policy(path: str | Path, model: PEMIRLModel) -> Policy:
    """Read a policy that ``pemirl adapt_reward`` or :meth:`Adaptation.save` wrote.

    It reads ``observation`` and ``context`` and writes ``action``; ``infer(model, one).action`` is
    the action that one demonstration asks for. Nothing is unpickled.

    Args:
        path: ``policy.safetensors`` of a run.
        model: the one whose reward the policy was trained on: its contexts are those that the
            policy reads.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file holds something else, or a policy of another size than this model's.
    """
    facts = read_metadata(path)
    if "activation" not in facts:
        raise ValueError(
            f"{path} holds weights of {sorted(facts)}; expected an adapted policy, such as "
            "policy.safetensors of pemirl adapt_reward (a model's own: load_model(...).policy)"
        )
    policy = model.new_policy(activation=facts["activation"])
    load_weights(path, {"policy": policy})
    return policy
