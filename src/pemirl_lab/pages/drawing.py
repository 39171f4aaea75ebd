"""The figures of a run: reward maps of unseen tasks, learning curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import torch

import pemirl_envs
from pemirl_lab.pages.figures import learning_curve, reward_maps, save_figure
from pemirl_lab.results import Score
from pemirl_trl import DemonstrationDataset, PEMIRLModel
from pemirl_trl.evaluation import distance_to_goal, position_grid, reward_on_grid


def draw_known_maps(
    environment: str, model: PEMIRLModel, demonstrations: DemonstrationDataset, path: Path
) -> None:
    """Reward maps, where r is a function of a position and the true tasks are known; else none."""
    planar = pemirl_envs.get_task(environment).planar and model.config.reward == "shaped"
    if planar and demonstrations.task is not None:
        draw_reward_maps(environment, model, demonstrations, path)


@torch.no_grad()
def draw_reward_maps(
    environment: str, model: PEMIRLModel, demonstrations: DemonstrationDataset, path: Path
) -> None:
    """r(s, m) of four unseen tasks beside the true reward, on the dynamics of ``environment``.

    The tasks are those nearest to four goals spread evenly over the range of the test goals.
    """
    layout = pemirl_envs.layout(environment)
    goals = demonstrations.tasks()["goal"]
    x = goals[:, 0]
    wanted = torch.linspace(float(x.min()), float(x.max()), 4)
    chosen = torch.stack([(x - w).abs().argmin() for w in wanted])
    few = demonstrations[chosen]
    context = model.encoder.get_dist(few.trajectories()).mean
    (x0, y0), (x1, y1) = layout.low, layout.high
    positions = position_grid(((x0, x1), (y0, y1)), (100, 100))
    learned = reward_on_grid(model.reward, context, positions)
    figure = reward_maps(
        learned,
        -distance_to_goal(positions, goals[chosen]),
        ((x0, x1), (y0, y1)),
        goals[chosen],
        start=layout.start,
        segments=list(layout.walls.values()),
        demonstrations=few.observation,
        titles=[f"goal x = {float(g[0]):.2f} m" for g in goals[chosen]],
    )
    save_figure(figure, path)


def draw_learning_curve(
    curves: Mapping[str, Sequence[Sequence[float]]], scores: Sequence[Score], path: Path
) -> None:
    """True return over environment steps, by stage; empty curves are left out."""
    series = {
        label: [([point[0] for point in curve], [point[1] for point in curve])]
        for label, curve in curves.items()
        if curve
    }
    references = {f"expert on {s.variant}": s.expert for s in scores if s.goals == "all"}
    figure = learning_curve(
        series,
        references=references,
        xlabel="environment steps",
        ylabel="true return (never seen by the learner)",
        title="Training: return of the exploring policy",
    )
    save_figure(figure, path)
