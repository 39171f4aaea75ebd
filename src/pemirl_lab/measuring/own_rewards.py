"""How close a reward is to the true one, on an environment of the user's own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from pemirl_lab.measuring.candidates import Candidate, task_parameters
from pemirl_lab.measuring.learned_rewards import ReportConfig
from pemirl_trl import DemonstrationDataset, InferContext, PEMIRLModel
from pemirl_trl.evaluation import RewardReport, reward_report, whole_episodes
from pemirl_trl.methods.environments import Episodes

TrueReward = Callable[[Tensor, Tensor], Tensor]
"""Observations ``[..., S]`` and tasks ``[..., P]`` to rewards ``[...]``."""


def own_coverage(
    make_env: Callable[[int, int], Any],
    demonstrations: DemonstrationDataset,
    candidate: Candidate,
    true_reward: TrueReward,
    *,
    episodes: int,
    seed: int,
) -> dict[str, TensorDictBase]:
    """Transitions ``[C, B]`` with ``context``, ``task`` and the true reward of what happened.

    Of uniformly random actions, the same for all tasks, which such an environment need not know;
    of each task's demonstration; and every second one of both.

    Raises:
        TypeError, ValueError: an environment that cannot be rolled out, or one that does not fit.
    """
    d = demonstrations
    # Its sizes are all that is asked of it: an environment is looked at through a model.
    model = PEMIRLModel(d.observation_dim, d.action_dim, d.horizon)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        some = InferContext(model.encoder, d.trajectories())
        env = Episodes(make_env, model, d, seed)(episodes, seed, some)
        rollouts = whole_episodes(env, None, d.horizon)
        env.close()
    keys = ("observation", "action", ("next", "observation"))
    flat = rollouts.select(*keys).reshape(-1)
    random = flat.expand(len(d), len(flat))
    demonstrated = TensorDict(d.trajectories().to_dict(), [len(d), d.horizon])
    coverage = {"random": random, "demonstrated": demonstrated}
    task = task_parameters(d)
    for name, batch in coverage.items():
        batch = batch.clone()
        batch["context"] = candidate.context.unsqueeze(1).expand(*batch.shape, -1)
        batch["task", "parameters"] = task.unsqueeze(1).expand(*batch.shape, -1)
        given = true_reward(batch["observation"], batch["task", "parameters"])
        batch["next", "reward"] = given.unsqueeze(-1)
        coverage[name] = batch
    mixed = [batch[:, ::2] for batch in coverage.values()]
    return {**coverage, "mixed": torch.cat(mixed, dim=1)}


def measure_own_reward(
    report: ReportConfig,
    candidate: Candidate,
    true_reward: TrueReward,
    coverage: dict[str, TensorDictBase],
    seed: int,
) -> tuple[RewardReport, int]:
    """The measures, and how many radial functions the shortest coverage allowed for."""
    # Beside the radial functions, potentials have the components of an observation and a constant.
    others = 1 + next(iter(coverage.values()))["observation"].shape[-1]
    features = min(report.features, *(b.shape[1] // 4 - others for b in coverage.values()))
    features = max(1, features)  # of shorter episodes shaping_subspace says what is missing

    def true(transitions: TensorDictBase) -> Tensor:
        return true_reward(transitions["observation"], transitions["task", "parameters"])

    measured = reward_report(
        candidate.rewards,
        true,
        coverage,
        gamma=candidate.gamma,
        epic_transitions=report.epic_transitions,
        epic_samples=report.epic_samples,
        features=features,
        seed=seed,
    )
    return measured, features
