"""Whether the context of a demonstration says its task, or only how that one went."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase

from pemirl_trl.data import DemonstrationDataset
from pemirl_trl.evaluation import whole_episodes
from pemirl_trl.methods.environments import Episodes
from pemirl_trl.modules import PEMIRLModel
from pemirl_trl.transforms import InferContext

ASKED = 200
"""Demonstrations whose contexts are asked for, at most."""
LEAST_RECOVERED = 0.85
"""Four tasks that were adapted to had 0.89 and more, two that failed 0.78 and less (docs/proofs.md,
one seed each)."""
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


def unrecovered(share: float | None) -> list[str]:
    """A warning where contexts do not say tasks; None is not known."""
    if share is None or share >= LEAST_RECOVERED:
        return []
    return [
        "the policy, asked for the contexts of demonstrations from other starts, does what q reads "
        f"as other contexts ({share:.2f} of a context is typically recovered; below "
        f"{LEAST_RECOVERED:g} is a sign): m does not say the task alone, or the policy does not "
        "imitate, and rewards of this model are likely wrong. Another seed, meta_il.part_share=0.5 "
        "where it is less, starts that are more alike, and units in which features and actions are "
        "alike may help (docs/faq.md)"
    ]


def _as_demonstrated(rollouts: TensorDictBase) -> TensorDictBase:
    """Rollouts ``[N, T]`` as an encoder reads demonstrations."""
    seen = rollouts.select("observation", "action", ("next", "observation")).copy()
    if "absorbing" in rollouts:  # no action is taken after an end
        seen.set("action", seen["action"].masked_fill(rollouts["absorbing"].unsqueeze(-1), 0))
    seen.batch_size = rollouts.batch_size[:1]
    return seen
