"""Whether a context says its task, and its reward is highest at what was shown: without labels."""

from __future__ import annotations

from typing import NamedTuple

import torch
from tensordict import TensorDictBase
from torch import Tensor

from pemirl_trl.data import DemonstrationDataset
from pemirl_trl.evaluation import whole_episodes
from pemirl_trl.methods.environments import Episodes
from pemirl_trl.modules import PEMIRLModel, TrainingFamily
from pemirl_trl.transforms import InferContext

ASKED = 200
"""Demonstrations whose contexts are asked for, at most."""
LEAST_RECOVERED = 0.85
"""Four tasks that were adapted to had 0.89 and more, two that failed 0.78 and less (docs/proofs.md,
one seed each)."""
BEST = 5
"""Demonstrations that earn most, whose place in m is looked at."""
MOST_OUTDONE, MOST_DISPLACED = 0.035, 0.28
"""Set on these: eight models whose rewards served had at most 0.028 and 0.26, two that nearly did
0.04 and 0.17, thirteen of two tasks that failed at least 0.024 and 0.30 (docs/faq.md)."""
SEED = 200_003
"""Added to the seed: the episodes are none of training's."""


@torch.no_grad()
def recovered_share(
    model: PEMIRLModel, demonstrations: DemonstrationDataset, episodes: Episodes, seed: int
) -> float:
    """How much of a context q typically finds again in what the policy did with it, up to 1.

    Meta-IL imitates each demonstration under a context of itself. Nothing makes that context the
    task: it may as well say how this one demonstration went, from where it began. Here the policy
    is asked for the contexts of demonstrations in episodes that begin elsewhere. If m is the task,
    q reads the same m off them. The share is 1 - e / v, with e the median squared error and v the
    variance of the contexts; of a median, since a policy that fails from some starts, or a pendulum
    that it cannot swing up, says little about the rest.

    Args:
        model: a trained one.
        demonstrations: of its training, as the model reads them.
        episodes: make its environment.
        seed: of the environment.
    """
    asked = demonstrations.trajectories()[:ASKED]
    infer = InferContext(model.encoder, asked, rollouts_per_context=1, draw="all", sample=False)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed + SEED)
        env = episodes(len(asked), seed + SEED, infer)
        rollouts = whole_episodes(env, model.policy, model.horizon)
        env.close(raise_if_closed=False)
    wanted = model.encoder.get_dist(asked).mean
    got = model.encoder.get_dist(_as_demonstrated(rollouts)).mean
    variance = (wanted - wanted.mean(0)).square().sum(1).mean()
    error = (got - wanted).square().sum(1).median()
    return float(1 - error / variance.clamp(min=1e-12))


class Sharpness(NamedTuple):
    """How well the rewards of demonstrations tell them from each other.

    Attributes:
        outdone: the share of the others that earn at least as much under a demonstration's reward
            as it does itself; mean over demonstrations.
        displaced: how far, in m, the mean of those that earn most (:data:`BEST`) is from the
            demonstration, in deviations of the contexts; median over demonstrations.
    """

    outdone: float
    displaced: float

    @property
    def blunt(self) -> bool:
        """Whether a policy that is trained on such rewards is likely to miss."""
        return self.outdone > MOST_OUTDONE or self.displaced > MOST_DISPLACED


@torch.no_grad()
def sharpness(model: PEMIRLModel, demonstrations: DemonstrationDataset) -> Sharpness:
    """Whether r(s, m) is highest at what was demonstrated: every pair of demonstrations is asked.

    If it is, hardly any demonstration of another task does better than the one that m is of, and
    those that come near are of tasks near by. Where r is blunt, or highest beside it, they are not.
    Of each demonstration the second half is judged, where starts matter less. Nothing is rolled
    out, and no label is needed.

    Args:
        model: a trained one.
        demonstrations: of its training, as the model reads them.
    """
    asked = demonstrations.trajectories()[:ASKED]
    contexts = model.encoder.get_dist(asked).mean
    observed = asked["observation"]
    steps = asked.get("mask", torch.ones(observed.shape[:2], dtype=torch.bool)).float()
    late = steps * (steps.cumsum(1) > steps.sum(1, keepdim=True) / 2)
    weights = late / late.sum(1, keepdim=True)

    def under(m: Tensor) -> Tensor:
        reward = model.reward.reward(observed, m.expand(*observed.shape[:2], -1))
        return (reward.squeeze(-1) * weights).sum(1)

    earned = torch.stack([under(m) for m in contexts])  # [context, demonstration]
    rivals = earned >= earned.diagonal().unsqueeze(1)  # with itself; a constant r is outdone by all
    best = earned.topk(min(BEST, len(contexts))).indices
    spread = (contexts - contexts.mean(0)).square().sum(1).mean().sqrt().clamp(min=1e-12)
    off = (contexts[best].mean(1) - contexts).norm(dim=1) / spread
    outdone = (rivals.sum(1) - 1).float().mean() / max(1, len(contexts) - 1)
    return Sharpness(float(outdone), float(off.median()))


def _told(family: TrainingFamily) -> Sharpness | None:
    if family.outdone is None or family.displaced is None:
        return None
    return Sharpness(family.outdone, family.displaced)


def measured(family: TrainingFamily) -> str:
    """What was measured without labels, in one line; empty where nothing was."""
    said = []
    if family.recovered is not None:
        said.append(
            f"{family.recovered:.2f} of a context is recovered ({LEAST_RECOVERED:g} or more: good)"
        )
    if (told := _told(family)) is not None:
        said.append(
            f"under its reward a demonstration is outdone by {100 * told.outdone:.1f} % of the "
            f"others ({100 * MOST_OUTDONE:g} % or less: good), and the best are "
            f"{told.displaced:.2f} deviations of m away ({MOST_DISPLACED:g} or less: good)"
        )
    return "; ".join(said)


def doubts(family: TrainingFamily) -> list[str]:
    """Warnings where contexts do not say tasks, or rewards are not highest at what was shown."""
    found = []
    told = _told(family)
    if told is not None and told.blunt:
        found.append(
            f"under the reward of a demonstration {100 * told.outdone:.1f} % of the others earn as "
            f"much as it does (above {100 * MOST_OUTDONE:g} % is a sign), and those that earn most "
            f"are {told.displaced:.2f} deviations of m away (above {MOST_DISPLACED:g}): r is "
            "blunt, or highest beside what was shown, and policies that are trained on it miss by "
            "as much. A larger and faster r may be sharper: model.reward_hidden=[128,128] "
            "training.reward_lr=0.003 training.final_reward_lr=0.0003 (docs/faq.md)"
        )
    if family.recovered is not None and family.recovered < LEAST_RECOVERED:
        wrong = (
            "the policy does not imitate, or m does not say the task alone. Rewards do tell the "
            "demonstrations apart, which speaks for the former: a new policy may do well"
            if told is not None and not told.blunt
            else "m does not say the task alone, or the policy does not imitate, and rewards of "
            "this model are likely wrong"
        )
        found.append(
            "the policy, asked for the contexts of demonstrations from other starts, does what q "
            f"reads as other contexts ({family.recovered:.2f} of a context is typically recovered; "
            f"below {LEAST_RECOVERED:g} is a sign): {wrong}. Another seed, meta_il.part_share=0.5 "
            "where it is less, starts that are more alike, and units in which features and actions "
            "are alike may help (docs/faq.md)"
        )
    return found


def _as_demonstrated(rollouts: TensorDictBase) -> TensorDictBase:
    """Rollouts ``[N, T]`` as an encoder reads demonstrations."""
    seen = rollouts.select("observation", "action", ("next", "observation")).copy()
    if "absorbing" in rollouts:  # no action is taken after an end
        seen.set("action", seen["action"].masked_fill(rollouts["absorbing"].unsqueeze(-1), 0))
    seen.batch_size = rollouts.batch_size[:1]
    return seen
