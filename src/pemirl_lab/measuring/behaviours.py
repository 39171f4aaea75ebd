"""What a learned reward makes of behaviours whose true returns are known."""

from __future__ import annotations

import torch
from adapt_reward import load_test_demonstrations
from domains import Actor, load_expert, rollouts_given_tasks
from omegaconf import DictConfig
from tensordict import TensorDictBase

from pemirl_trl import PEMIRLModel
from pemirl_trl.evaluation import spearman


@torch.no_grad()
def behaviour_measures(config: DictConfig, model: PEMIRLModel) -> dict[str, float]:
    """r(s, m), mean per step, of four behaviours under the test dynamics, by their names.

    ``expert`` was trained there, ``carried_over`` on the training dynamics; ``still`` does nothing
    and ``random`` anything. ``expert_other_task`` is the expert's under another task's
    demonstration, and ``spearman`` the rank correlation of learned and true returns over all
    rollouts. A reward that prefers standing still to the expert cannot make a policy move.
    """
    name = config.test_environment
    demonstrations = load_test_demonstrations(config)
    contexts = model.encoder.get_dist(demonstrations.trajectories()).mean
    training, test = (config[k].split("/")[1] for k in ("environment", "test_environment"))

    def still(tensordict: TensorDictBase) -> TensorDictBase:  # TorchRL goes by that name
        return tensordict.set("action", torch.zeros(len(tensordict), model.action_dim))

    actors: dict[str, Actor] = {
        "expert": load_expert(config.experts[test]),
        "carried_over": load_expert(config.experts[training]),
        "still": still,
        "random": None,
    }
    measures, learned_returns, true_returns = {}, [], []
    for label, actor in actors.items():
        rollouts = rollouts_given_tasks(name, actor, demonstrations.tasks(), config)
        observation = rollouts["observation"]

        def score(m: torch.Tensor, observation: torch.Tensor = observation) -> torch.Tensor:
            per_step = m.repeat_interleave(config.evaluation.episodes, 0).unsqueeze(1)
            m_steps = per_step.expand(*observation.shape[:-1], -1)
            return model.reward.reward(observation, m_steps).mean((1, 2))  # [rollouts]

        learned = score(contexts)
        measures[f"behaviour/{label}"] = float(learned.mean())
        if label == "expert":
            measures["behaviour/expert_other_task"] = float(score(contexts.roll(1, 0)).mean())
        learned_returns.append(learned)
        true_returns.append(rollouts["next", "reward"].sum((1, 2)))
    rank = spearman(torch.cat(learned_returns), torch.cat(true_returns))
    return {**measures, "behaviour/spearman": float(rank)}
