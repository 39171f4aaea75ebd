"""Demonstrations of the expert, and the policy's own rollouts."""

from pemirl_trl.data.demonstrations import DemonstrationDataset
from pemirl_trl.data.doctor import Finding, examine
from pemirl_trl.data.negatives import NEGATIVE_KEYS, Negatives, gather_steps
from pemirl_trl.data.pairs import Pairs, pair_by_task
from pemirl_trl.data.parts import in_parts
from pemirl_trl.data.provenance import Provenance

__all__ = [
    "NEGATIVE_KEYS",
    "DemonstrationDataset",
    "Finding",
    "Negatives",
    "Pairs",
    "Provenance",
    "examine",
    "gather_steps",
    "in_parts",
    "pair_by_task",
]
