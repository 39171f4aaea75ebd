"""How close is the learned reward to the true one? One page with figures.

    python recipes/reward_report.py model_file=runs/my_run/model.safetensors
    python recipes/reward_report.py transfer=true  # and what policies trained on it reach

Writes ``report.md``, ``report.json`` and figures to ``run_dir``. The latent m of a task is the mean
of q(m | its one demonstration).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import hydra
import torch
from adapt_reward import adapt, load_test_demonstrations
from config import typed
from domains import (
    environment,
    given_tasks,
    load_expert,
    returns_given_demonstrations,
    returns_given_tasks,
    returns_of_random_actions,
    run_file,
    true_reward_module,
)
from omegaconf import DictConfig
from run_folder import RunFolder, say
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

import pemirl_envs
from pemirl_trl import ContextPolicy, DemonstrationDataset, PEMIRLModel, SampleTasks
from pemirl_trl.evaluation import (
    RewardFunction,
    RewardReport,
    distance_to_goal,
    map_of_reward,
    position_grid,
    reward_report,
    shaped_reward_of,
    state_reward_of,
)
from pemirl_trl.evaluation.figures import reward_maps, reward_scatter, save_figure
from pemirl_trl.evaluation.reward_quality import Bounds
from pemirl_trl.files import atomic_path
from pemirl_trl.pretrained import load_model

DRAWN_TASKS = 4
DRAWN_TRANSITIONS = 150  # per task, in a scatter plot


@dataclass(frozen=True)
class ReportConfig:
    """What is measured.

    Args:
        episodes: per task, of random actions and of the expert.
        resolution: cells of a map along each axis.
        epic_transitions, epic_samples, features: see
            :func:`pemirl_trl.evaluation.reward_report`.
    """

    episodes: int = 5
    resolution: int = 60
    epic_transitions: int = 128
    epic_samples: int = 64
    features: int = 64


def measure_reward(
    config: DictConfig, model: PEMIRLModel, demonstrations: DemonstrationDataset
) -> RewardReport:
    """Measure r alone and the shaped f of one demonstration per task, under the test dynamics.

    Args:
        config: has ``test_environment``, ``experts``, ``threads``, ``evaluation.seed``; ``report``
            where it differs from :class:`ReportConfig`.
        model: whose reward and encoder.
        demonstrations: one per task, with the tasks.
    """
    return _measure(config, model, demonstrations, coverage_of(config, model, demonstrations))


def coverage_of(
    config: DictConfig, model: PEMIRLModel, demonstrations: DemonstrationDataset
) -> dict[str, TensorDictBase]:
    """Transitions ``[C, episodes * T]`` under the test dynamics, with ``context`` and ``task``.

    Of uniformly random actions; of the expert, drawing its actions; and every second one of both.
    """
    with torch.no_grad(), torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.evaluation.seed)
        context = model.encoder.get_dist(demonstrations.trajectories()).mean  # [C, D]
        expert = load_expert(config.experts[config.test_environment.split("/")[1]])
        random = _transitions(config, None, demonstrations.tasks(), context)
        expert = _transitions(config, expert, demonstrations.tasks(), context)
    mixed = torch.cat([random[:, ::2], expert[:, ::2]], dim=1)
    return {"random": random, "expert": expert, "mixed": mixed}


def true_reward(name: str, task_key: str) -> RewardFunction:
    """The reward that a planar task gives for any transition, possible or not."""
    module = true_reward_module(name, task_key)

    def reward(transitions: TensorDictBase) -> Tensor:
        return module(transitions.select(*module.in_keys))["learned_reward"].squeeze(-1)

    return reward


def _transitions(
    config: DictConfig, policy: ContextPolicy | None, tasks: TensorDictBase, context: Tensor
) -> TensorDict:
    episodes = _settings(config).episodes
    env = environment(
        config.test_environment,
        len(tasks) * episodes,
        SampleTasks(given_tasks(tasks), rollouts_per_task=episodes),
        seed=config.evaluation.seed,
        threads=config.threads,
    )
    horizon = pemirl_envs.get_task(config.test_environment).horizon
    rollouts = env.rollout(horizon, policy, break_when_any_done=False)  # [C * episodes, T]
    kept = rollouts.select("observation", "action", ("next", "observation"), ("next", "reward"))
    kept["task"] = rollouts["task"]
    kept = kept.reshape(len(tasks), episodes * horizon).contiguous()
    return kept.set("context", context.unsqueeze(1).expand(*kept.shape, -1))


def _settings(config: DictConfig) -> ReportConfig:
    return typed(ReportConfig, config.get("report") or {})


def _rewards(model: PEMIRLModel) -> dict[str, RewardFunction]:
    return {"r": state_reward_of(model.reward), "f": shaped_reward_of(model.reward)}


def _grid(config: DictConfig) -> tuple[Bounds, Tensor]:
    plan = pemirl_envs.layout(config.test_environment)
    bounds = ((plan.low[0], plan.high[0]), (plan.low[1], plan.high[1]))
    cells = _settings(config).resolution
    return bounds, position_grid(bounds, (cells, cells))


def _measure(
    config: DictConfig,
    model: PEMIRLModel,
    demonstrations: DemonstrationDataset,
    coverage: Mapping[str, TensorDictBase],
) -> RewardReport:
    settings = _settings(config)
    return reward_report(
        _rewards(model),
        true_reward(config.test_environment, config.task_key),
        coverage,
        gamma=model.reward.gamma,
        positions=_grid(config)[1],
        goals=demonstrations.tasks()["goal"],
        epic_transitions=settings.epic_transitions,
        epic_samples=settings.epic_samples,
        features=settings.features,
        seed=config.evaluation.seed,
    )


def draw(
    config: DictConfig,
    folder: RunFolder,
    model: PEMIRLModel,
    demonstrations: DemonstrationDataset,
    coverage: Mapping[str, TensorDictBase],
) -> None:
    """Maps of r and f, and r over the true reward, of tasks spread over the range of goals."""
    goals = demonstrations.tasks()["goal"]
    spread = torch.linspace(0, len(goals) - 1, DRAWN_TASKS).round().long()
    chosen = goals[:, 0].argsort()[spread]
    some = {name: batch[chosen] for name, batch in coverage.items()}
    titles = [f"goal x = {float(g[0]):.2f} m" for g in goals[chosen]]
    bounds, positions = _grid(config)
    plan = pemirl_envs.layout(config.test_environment)
    rewards = _rewards(model)
    maps = {k: map_of_reward(r, some["random"], positions) for k, r in rewards.items()}
    figure = reward_maps(
        maps["r"],
        -distance_to_goal(positions, goals[chosen]),
        bounds,
        goals[chosen],
        shaped=maps["f"],
        start=plan.start,
        segments=list(plan.walls.values()),
        demonstrations=demonstrations[chosen].observation,
        titles=titles,
    )
    save_figure(figure, folder.file("figures/reward_maps.png"))
    every = max(1, coverage["random"].shape[1] // DRAWN_TRANSITIONS)
    some = {name: batch[:, ::every] for name, batch in some.items()}
    with torch.no_grad():
        learned = {k: rewards["r"](batch).squeeze(-1) for k, batch in some.items()}
    true = {k: batch["next", "reward"].squeeze(-1) for k, batch in some.items()}
    save_figure(reward_scatter(learned, true, titles), folder.file("figures/scatter.png"))


def transfer(
    config: DictConfig, folder: RunFolder, model: PEMIRLModel, demonstrations: DemonstrationDataset
) -> dict[str, dict[str, float]]:
    """True returns of policies trained on r: under the training dynamics, and under changed ones.

    Each beside the expert's and random actions'; means over tasks.
    """
    tasks = demonstrations.tasks()
    table = {}
    for kind, name in (("self-transfer", config.environment), ("shift", config.test_environment)):
        policy, _ = adapt(config, folder, model, environment_name=name, stage=kind)
        expert = load_expert(config.experts[name.split("/")[1]])
        returns = {
            "random": returns_of_random_actions(name, tasks, config),
            "expert": returns_given_tasks(name, expert, tasks, config),
            "learned reward": returns_given_demonstrations(
                name, model, policy, demonstrations, config
            ),
        }
        table[f"{kind} ({name})"] = {k: float(v.mean()) for k, v in returns.items()}
    return table


PAGE = """# Reward report

`{model}`, {tasks} unseen tasks, the reward of each inferred from one demonstration, measured under
the dynamics of `{environment}`. r: the learned reward r(s, m). f: with its potential,
f = r + gamma h(s') - h(s). Means over tasks, the worst task in parentheses.

{table}
Coverage per task: *random*, {transitions} transitions of uniformly random actions; *expert*, as
many of the expert trained on the true reward, drawing its actions; *mixed*, every second one of
both; *map*, a grid of {resolution} x {resolution} states at rest (s' = s, no action), against minus
the distance to the goal. Everywhere else the true reward is the one that the environment gave.

- Spearman, Pearson: correlation with the true reward, shaping and all; 1 is perfect.
- EPIC (Gleave et al., ICLR 2021): 0 where the two rewards differ by scale, constant and potential
  shaping alone, about 0.71 for unrelated ones, 1 for opposite ones. It asks for rewards of
  transitions that the dynamics do not allow.
- feasible distance (after Skalse et al., ICLR 2024): the same scale, from the transitions that
  happened alone; shaping is taken out by regression on {features} radial functions.
- argmax error: from the map's maximum to the goal.

![Maps of r, f and the true reward](figures/reward_maps.png)

![Learned over true rewards](figures/scatter.png)
{transfer}"""


def page(
    config: DictConfig, report: RewardReport, tasks: int, returns: Mapping[str, Mapping[str, float]]
) -> str:
    """The report as Markdown."""
    settings = _settings(config)
    lines = [
        f"| {kind} | {' | '.join(f'{v:.2f}' for v in r.values())} |" for kind, r in returns.items()
    ]
    header = (
        "\nTrue returns, means over tasks, of new policies trained on r:\n\n"
        "| | random | expert | learned reward |\n| --- | --- | --- | --- |\n"
    )
    return PAGE.format(
        model=config.model_file,
        tasks=tasks,
        environment=config.test_environment,
        table=report.markdown(),
        transitions=settings.episodes * pemirl_envs.get_task(config.test_environment).horizon,
        resolution=settings.resolution,
        features=settings.features,
        transfer=header + "\n".join(lines) + "\n" if returns else "",
    )


def write_report(config: DictConfig, folder: RunFolder, model: PEMIRLModel) -> RewardReport:
    """Measure, draw, and write the page.

    Raises:
        ValueError: the task's true reward is not a function of a position.
    """
    if not config.planar:
        raise ValueError(
            f"task={config.task} is not planar: this report needs the true reward of transitions "
            "that never happened, as a function of the position alone; use "
            "pemirl_trl.evaluation.reward_report with your own"
        )
    demonstrations = load_test_demonstrations(config)
    with folder.timed("report"):
        coverage = coverage_of(config, model, demonstrations)
        report = _measure(config, model, demonstrations, coverage)
        draw(config, folder, model, demonstrations, coverage)
    returns = transfer(config, folder, model, demonstrations) if config.transfer else {}
    folder.write_json(
        "report.json",
        {
            "summary": report.summary(),
            "per_task": {"/".join(m): values.tolist() for m, values in report.per_task.items()},
            "goals": demonstrations.tasks()["goal"].tolist(),
            "returns": returns,
        },
    )
    with atomic_path(folder.file("report.md")) as temporary:
        temporary.write_text(page(config, report, len(demonstrations), returns), encoding="utf-8")
    say(f"{report.markdown()}report -> {folder.file('report.md')}")
    return report


@hydra.main(config_path="conf", config_name="reward_report", version_base="1.3")
def main(config: DictConfig) -> None:
    """Entry point."""
    model = load_model(run_file(config.model_file, "meta_train.py"))
    write_report(config, RunFolder(config), model)


if __name__ == "__main__":
    main()
