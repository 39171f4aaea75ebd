"""Whether a context says its task, and its reward is highest at what was shown: without labels."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase

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
MOST_OUTDONE = 0.035
"""Nine models whose rewards served had 0.004 to 0.027, five that were blunt 0.04 to 0.1
(docs/proofs.md)."""
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


@torch.no_grad()
def outdone_share(model: PEMIRLModel, demonstrations: DemonstrationDataset) -> float:
    """How many others earn at least as much under a demonstration's reward as it does itself.

    If r(s, m) is highest at what was demonstrated, hardly any demonstration of another task does
    better: the share is near 0. Where r is blunt, or highest beside it, those beside it do. Of
    each demonstration the second half is judged, where starts matter less; the share is the mean
    over demonstrations. Nothing is rolled out, and no label is needed.

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
    earned = torch.stack(  # [context, demonstration]
        [
            (
                model.reward.reward(observed, m.expand(*observed.shape[:2], -1)).squeeze(-1)
                * weights
            ).sum(1)
            for m in contexts
        ]
    )
    rivals = earned >= earned.diagonal().unsqueeze(1)  # with itself; a constant r is outdone by all
    return float((rivals.sum(1) - 1).float().mean() / max(1, len(asked) - 1))


def measured(family: TrainingFamily) -> str:
    """What was measured without labels, in one line; empty where nothing was."""
    said = []
    if family.recovered is not None:
        said.append(
            f"{family.recovered:.2f} of a context is recovered ({LEAST_RECOVERED:g} or more: good)"
        )
    if family.outdone is not None:
        said.append(
            f"under its reward a demonstration is outdone by {100 * family.outdone:.1f} % of the "
            f"others ({100 * MOST_OUTDONE:g} % or less: good)"
        )
    return "; ".join(said)


def doubts(family: TrainingFamily) -> list[str]:
    """Warnings where contexts do not say tasks, or rewards are not highest at what was shown."""
    found = []
    blunt = False
    if family.outdone is not None and family.outdone > MOST_OUTDONE:
        blunt = True
        found.append(
            f"under the reward of a demonstration {100 * family.outdone:.1f} % of the others earn "
            f"more than it does (above {100 * MOST_OUTDONE:g} % is a sign): r is blunt, or highest "
            "beside what was shown, and policies that are trained on it miss by as much. A larger "
            "and faster r is sharper: model.reward_hidden=[128,128] training.reward_lr=0.003 "
            "training.final_reward_lr=0.0003 (docs/faq.md)"
        )
    if family.recovered is not None and family.recovered < LEAST_RECOVERED:
        wrong = (
            "m does not say the task alone, or the policy does not imitate, and rewards of this "
            "model are likely wrong"
            if blunt or family.outdone is None
            else "the policy does not imitate, or m does not say the task alone. Rewards do tell "
            "the demonstrations apart, which speaks for the former: a new policy may do well"
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
