"""How close is the learned reward to the true one? One page with figures.

    pemirl reward_report model_file=runs/my_run/model.safetensors
    pemirl reward_report transfer=true  # and what policies trained on it reach

Writes ``report.md``, ``report.json`` and figures to ``run_dir``. The latent m of a task is the mean
of q(m | its one demonstration).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field

import torch
from pydantic.dataclasses import dataclass
from tensordict import TensorDictBase

import pemirl_envs
from pemirl_lab.commands.adapt_reward import adapt
from pemirl_lab.measuring.learned_rewards import (
    ReportConfig,
    coverage_of,
    grid,
    measure_reward,
    rewards_of,
)
from pemirl_lab.measuring.scores import Scorer, load_test_demonstrations
from pemirl_lab.pages.figures import reward_maps, reward_scatter, save_figure
from pemirl_lab.runs.places import data_file, run_file
from pemirl_lab.runs.run_folder import RunFolder, say
from pemirl_lab.runs.settings import Settings
from pemirl_trl import DemonstrationDataset, PEMIRLModel
from pemirl_trl.configuration import CHECKED
from pemirl_trl.evaluation import RewardReport, distance_to_goal, map_of_reward
from pemirl_trl.files import atomic_path
from pemirl_trl.pretrained import load_model

DRAWN_TASKS = 4
DRAWN_TRANSITIONS = 150  # per task, in a scatter plot


@dataclass(frozen=True, config=CHECKED)
class Own:
    """What this command has of its own.

    Attributes:
        model_file: whose reward.
        transfer: whether policies are trained on it, too.
        report: what is measured.
    """

    model_file: str
    transfer: bool = False
    report: ReportConfig = field(default_factory=ReportConfig)


def run(settings: Settings, own: Own) -> RewardReport:
    """Measure, draw, and write the page.

    Raises:
        ValueError: the task's true reward is not a function of a position.
    """
    if not settings.planar:
        raise ValueError(
            f"task={settings.task} is not planar: this report needs the true reward of transitions "
            "that never happened, as a function of the position alone; use "
            "pemirl_trl.evaluation.reward_report with your own"
        )
    folder = RunFolder.of(settings)
    model = load_model(folder.reads("model", run_file(own.model_file, "meta_train")))
    folder.reads("test demonstrations", data_file(settings.test_demonstrations))
    demonstrations = load_test_demonstrations(settings)
    with folder.timed("report"):
        coverage = coverage_of(settings, own.report.episodes, model, demonstrations)
        report = measure_reward(settings, own.report, model, demonstrations, coverage)
        draw(settings, own, folder, model, demonstrations, coverage)
    returns = transfer(settings, folder, model, demonstrations) if own.transfer else {}
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
        text = page(settings, own, report, len(demonstrations), returns)
        temporary.write_text(text, encoding="utf-8")
    say(f"{report.markdown()}report -> {folder.file('report.md')}")
    return report


def draw(
    settings: Settings,
    own: Own,
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
    bounds, positions = grid(settings, own.report.resolution)
    plan = pemirl_envs.layout(settings.test_environment)
    rewards = rewards_of(model)
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
    settings: Settings,
    folder: RunFolder,
    model: PEMIRLModel,
    demonstrations: DemonstrationDataset,
) -> dict[str, dict[str, float]]:
    """True returns of policies trained on r: under the training dynamics, and under changed ones.

    Each beside the expert's and random actions'; means over tasks.
    """
    scorer, table = Scorer(settings, demonstrations), {}
    where = {"self-transfer": settings.environment, "shift": settings.test_environment}
    for kind, name in where.items():
        policy, _ = adapt(settings, folder, model, environment_name=name, stage=kind)
        returns = {
            "random": scorer.references(name)["random"],
            "expert": scorer.references(name)["expert"],
            "learned reward": scorer.returns(name, model, policy),
        }
        table[f"{kind} ({name})"] = {k: float(v.mean()) for k, v in returns.items()}
    return table


PAGE = """# Reward report

`{model}`, {tasks} unseen tasks, the reward of each inferred from one demonstration, measured under
the dynamics of `{environment}`. r: the learned reward r(s, m). f: with its potential,
f = r + gamma h(s') - h(s). Means over tasks, the worst task in parentheses.

{table}
Coverage per task: *random*, {transitions} transitions of uniformly random actions; *expert*, as
many of the expert trained on the true reward, on its mean actions; *mixed*, every second one of
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
    settings: Settings,
    own: Own,
    report: RewardReport,
    tasks: int,
    returns: Mapping[str, Mapping[str, float]],
) -> str:
    """The report as Markdown."""
    lines = [
        f"| {kind} | {' | '.join(f'{v:.2f}' for v in r.values())} |" for kind, r in returns.items()
    ]
    header = (
        "\nTrue returns, means over tasks, of new policies trained on r:\n\n"
        "| | random | expert | learned reward |\n| --- | --- | --- | --- |\n"
    )
    return PAGE.format(
        model=own.model_file,
        tasks=tasks,
        environment=settings.test_environment,
        table=report.markdown(),
        transitions=own.report.episodes * pemirl_envs.get_task(settings.test_environment).horizon,
        resolution=own.report.resolution,
        features=own.report.features,
        transfer=header + "\n".join(lines) + "\n" if returns else "",
    )
