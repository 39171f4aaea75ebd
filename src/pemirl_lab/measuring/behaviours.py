"""What a learned reward makes of behaviours whose true returns are known."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from torch import Tensor

from pemirl_lab.measuring.experts import load_expert
from pemirl_lab.measuring.rollouts import evaluation_episodes, of_tasks
from pemirl_lab.measuring.scores import load_test_demonstrations
from pemirl_lab.runs.settings import Settings
from pemirl_trl import PEMIRLModel
from pemirl_trl.evaluation import Actor, spearman


@torch.no_grad()
def behaviour_measures(settings: Settings, model: PEMIRLModel) -> dict[str, float]:
    """r(s, m), mean per step, of four behaviours under the test dynamics, by their names.

    ``expert`` was trained there, ``carried_over`` on the training dynamics; ``still`` does nothing
    and ``random`` anything. ``expert_other_task`` is the expert's under another task's
    demonstration, and ``spearman`` the rank correlation of learned and true returns over all
    rollouts. A reward that prefers standing still to the expert cannot make a policy move.
    """
    demonstrations, episodes = load_test_demonstrations(settings), settings.evaluation.episodes
    contexts = model.encoder.get_dist(demonstrations.trajectories()).mean
    tasks = demonstrations.tasks()

    def still(tensordict: TensorDictBase) -> TensorDictBase:  # TorchRL goes by that name
        return tensordict.set("action", torch.zeros(len(tensordict), model.action_dim))

    actors: dict[str, Actor] = {
        "expert": load_expert(settings.expert_file(settings.test_environment)),
        "carried_over": load_expert(settings.expert_file(settings.environment)),
        "still": still,
        "random": None,
    }
    measures: dict[str, float] = {}
    learned_returns, true_returns = [], []
    for label, actor in actors.items():
        rollouts = evaluation_episodes(
            settings, settings.test_environment, actor, of_tasks(tasks, episodes), len(tasks)
        )
        learned = _mean_reward(model, contexts, rollouts, episodes)
        measures[f"behaviour/{label}"] = float(learned.mean())
        if label == "expert":
            others = _mean_reward(model, contexts.roll(1, 0), rollouts, episodes)
            measures["behaviour/expert_other_task"] = float(others.mean())
        learned_returns.append(learned)
        true_returns.append(rollouts["next", "reward"].sum((1, 2)))
    rank = spearman(torch.cat(learned_returns), torch.cat(true_returns))
    return {**measures, "behaviour/spearman": float(rank)}


def _mean_reward(
    model: PEMIRLModel, contexts: Tensor, rollouts: TensorDictBase, episodes: int
) -> Tensor:
    """What adaptation would maximise, mean per step ``[rollouts]``, of so many per context."""
    scored = rollouts.select("observation", "action")  # r reads no next observation
    m = contexts.repeat_interleave(episodes, 0).unsqueeze(1)
    scored["context"] = m.expand(*scored.shape, -1)
    return model.reward(scored)["learned_reward"].mean((1, 2))
