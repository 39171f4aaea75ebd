"""Roll an expert out into demonstrations, so many per task of a split.

    pemirl collect_demos
    pemirl collect_demos split=test output=data/point_maze_test.safetensors
    pemirl collect_demos expert=[one.safetensors,other.safetensors]     # by turns

Writes one safetensors file to ``output``. Actions are drawn from the expert's distribution, as
maximum-entropy IRL assumes. Task parameters are stored for metrics; no learner reads them.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from pydantic.dataclasses import dataclass
from tensordict import TensorDictBase

import pemirl_envs
from pemirl_lab.measuring.experts import load_expert, random_rollouts
from pemirl_lab.measuring.rollouts import environment, of_tasks
from pemirl_lab.runs.places import data_file
from pemirl_lab.runs.run_folder import say
from pemirl_lab.runs.settings import Settings
from pemirl_trl import DemonstrationDataset, Provenance, __version__
from pemirl_trl.configuration import CHECKED, Count
from pemirl_trl.evaluation import Actor, whole_episodes
from pemirl_trl.files import read_metadata


@dataclass(frozen=True, config=CHECKED)
class Own:
    """What this command has of its own.

    Attributes:
        split: whose tasks are demonstrated.
        per_task: how many demonstrations of each.
        output: the file.
        expert: file of the expert, or several, who demonstrate by turns, so that a pile is not one
            network's habits; None: the task's.
    """

    split: str
    per_task: Count
    output: str
    expert: str | list[str] | None = None


def run(settings: Settings, own: Own) -> DemonstrationDataset:
    """Collect and save; ``per_task`` demonstrations of each task stand in a row."""
    torch.manual_seed(settings.seed)
    name = settings.environment
    tasks = pemirl_envs.task_parameters(name, own.split)
    count = tasks.batch_size[0] * own.per_task
    where = {"seed": settings.seed, "threads": settings.threads}
    env = environment(name, count, of_tasks(tasks, own.per_task), **where)
    given = own.expert or settings.expert_file(name)
    paths = [given] if isinstance(given, str) else given
    # Loading once took these random steps. The published files were drawn after them, and the
    # commands on their cards still make them.
    random_rollouts(read_metadata(data_file(paths[0]))["environment"])
    horizon = pemirl_envs.get_task(name).horizon
    rollouts = whole_episodes(env, by_turns(paths), horizon, sample=True)
    mean_return = float(rollouts["next", "reward"].sum(1).mean())
    provenance = Provenance(
        environment=name,
        seed=settings.seed,
        expert_return=mean_return,
        code_version=__version__,
        command=(
            f"pemirl collect_demos environment={name} split={own.split} per_task={own.per_task} "
            f"seed={settings.seed}" + (f" expert=[{','.join(paths)}]" if own.expert else "")
        ),
        extra={"split": own.split, "per_task": str(own.per_task)},
    )
    demonstrations = DemonstrationDataset.from_rollouts(rollouts, provenance)
    demonstrations.save(own.output)
    say(
        f"{len(demonstrations)} demonstrations of {tasks.batch_size[0]} tasks, mean return "
        f"{mean_return:.2f} -> {own.output}"
    )
    return demonstrations


def by_turns(paths: Sequence[str]) -> Actor:
    """The expert of a file; of several files, the one whose turn an episode is."""
    experts = [load_expert(path) for path in paths]
    if len(experts) == 1:
        return experts[0]

    def act(tensordict: TensorDictBase) -> TensorDictBase:
        actions = torch.stack([expert(tensordict)["action"] for expert in experts])
        rows = torch.arange(actions.shape[1])
        return tensordict.set("action", actions[rows % len(experts), rows])

    return act
