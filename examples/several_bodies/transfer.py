"""Does a reward transfer, without being told where to look, once several bodies demonstrate?

    python examples/several_bodies/transfer.py ant found 2,4 0 1 2      # components, bodies, seeds
    python examples/several_bodies/transfer.py sawyer_pusher whole 1,4 0

Nobody says which components r may read. Demonstrations come in pairs: of one task, by two bodies
(:func:`pemirl_trl.data.pair_by_task`); m is inferred from one, and the other is imitated and told
from the policy's own attempts in that body. The policy is told the body, r is not, and r reads

- ``whole``: the whole state;
- ``found``: what tells tasks apart in a body that was left out, m being what the demonstrations of
  a task agree on (:func:`pemirl_trl.evaluation.held_out_information` above 0 in every body).

Then, with one demonstration of each unseen task by the first body, a policy is trained on r under
dynamics that none of the bodies has. Writes
``results/transfer/several_bodies_TASK/COMPONENTS_bodiesB_seedN.json``; a run that died goes on
where it was. The numbers are on docs/transfer.md.
"""

from __future__ import annotations

import dataclasses
import json
import logging
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, get_args

import torch
from families import FAMILIES, Family, component_names
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import Compose, EnvBase, TransformedEnv

from pemirl_envs import Controller, TaskEnv, get_task
from pemirl_lab.commands.meta_train import Own
from pemirl_lab.results import environment_facts
from pemirl_lab.runs.composition import compose, plain
from pemirl_lab.runs.settings import Settings, parse
from pemirl_trl import (
    DemonstrationDataset,
    InferContext,
    PEMIRLModel,
    Provenance,
    SampleTasks,
    TellBody,
)
from pemirl_trl.data import Pairs, pair_by_task
from pemirl_trl.evaluation import (
    Actor,
    agreed_contexts,
    held_out_information,
    linear_probe,
    whole_episodes,
)
from pemirl_trl.files import atomic_path
from pemirl_trl.methods import (
    MetaIL,
    PolicyOptimization,
    build,
    initial_policy,
    new_model,
    start_from,
)
from pemirl_trl.methods.stages import RunStage, stages

ROOT = Path(__file__).parents[2]
EPISODES = 10  # of each unseen task
Reads = Literal["whole", "found"]


class Experiment:
    """One family, so many of its bodies, one seed.

    Args:
        family: of bodies.
        reads: what r reads: ``"whole"`` or ``"found"``.
        count: how many of them demonstrate.
        seed: of everything.
        overrides: of the experiment's settings, as on the command line.
    """

    def __init__(
        self, family: Family, reads: Reads, count: int, seed: int, *overrides: str
    ) -> None:
        self.family, self.reads, self.count, self.seed = family, reads, count, seed
        chosen = [f"experiment={family.task}", f"seed={seed}", *overrides]
        self.settings: Settings = parse(plain(compose("meta_train", chosen)), Own)[0]
        bodies = family.bodies[:count]
        self.task = family.several([body.task for body in bodies])
        self.demonstrators = [body.demonstrator() for body in bodies]
        self.changed = get_task(family.changed)

    def env(self, task: Any, num_envs: int, transform: Any, seed: int) -> EnvBase:
        """So many episodes of a task, told which of the demonstrated bodies each of them has."""
        base = TaskEnv(task, num_envs, seed=seed, num_threads=1)
        return TransformedEnv(base, Compose(transform, TellBody(self.count)))

    # --- demonstrations

    def tasks(self, split: str, bodies: int) -> TensorDict:
        """All tasks of a split in the first so many bodies, the bodies of a task in a row."""
        every = self.family.several([b.task for b in self.family.bodies[: self.count]])
        drawn = every.task_set(split)
        keep = drawn["body"].argmax(-1) < bodies
        return TensorDict({name: value[keep] for name, value in drawn.items()}, [int(keep.sum())])

    def demonstrate(self, split: str, bodies: int, each: int, seed: int) -> DemonstrationDataset:
        """So many demonstrations of each task by each body, whole episodes."""
        tasks = self.tasks(split, bodies).repeat_interleave(each)
        body = tasks["body"].argmax(-1)

        def act(tensordict: TensorDictBase) -> TensorDictBase:
            size = self.changed.observation_size
            seen, given = tensordict["observation"][:, :size], tensordict["task"]
            actions = [actor(seen, dict(given.items())) for actor in self.demonstrators]
            return tensordict.set("action", torch.stack(actions, 1)[torch.arange(len(body)), body])

        torch.manual_seed(seed)
        env = self.env(self.task, len(tasks), SampleTasks(lambda count: tasks), seed)
        rollouts = whole_episodes(env, act, self.task.horizon, sample=True)
        return DemonstrationDataset.from_rollouts(rollouts, Provenance())

    def numbers(self, data: DemonstrationDataset) -> Tensor:
        """Equal ones for demonstrations of the same task, ``[M]``: all that is said of tasks."""
        return data.tasks()[self.task.task_key].unique(dim=0, return_inverse=True)[1]

    # --- training

    def train(self, stage: RunStage, data: DemonstrationDataset, pairs: Pairs) -> PEMIRLModel:
        """Meta-IL and the experiment's method, on pairs; r reads some of the state, and no body."""
        torch.manual_seed(self.seed)
        given = self.settings.learning
        learning = dataclasses.replace(given, reward_reads="observation")
        every = list(range(self.changed.observation_size))
        imitation = new_model(data, learning, reward_features=every)
        stage("meta-il", MetaIL(imitation, pairs.trajectories, learning.meta_il))
        read = self.found(imitation, data) if self.reads == "found" else every
        torch.manual_seed(self.seed)
        model = new_model(data, learning, reward_features=read)
        start_from(model, imitation, learning)
        rollouts = learning.training.rollouts_per_context
        infer = InferContext(
            model.encoder,
            pairs.trajectories,
            rollouts_per_context=rollouts,
            tasks=data.tasks()[pairs.rows],
        )
        env = self.env(self.task, learning.contexts_per_batch * rollouts, infer, self.seed)
        stage("method", build(learning, model, env, pairs.trajectories))
        return model

    def found(self, model: PEMIRLModel, data: DemonstrationDataset) -> list[int]:
        """The components that tell tasks apart in every body, the others having been asked.

        Raises:
            ValueError: there is none.
        """
        trajectories, body = data.trajectories(), data.tasks()["body"].argmax(-1)
        with torch.no_grad():
            means = model.encoder.get_dist(trajectories).mean
        information = held_out_information(
            trajectories["observation"][..., : self.changed.observation_size],
            agreed_contexts(means, self.numbers(data), body),
            body,
            generator=torch.Generator().manual_seed(self.seed),
        )
        worst = information.min(0).values
        found = (worst > 0).nonzero().flatten().tolist()
        if not found:
            raise ValueError(
                f"no component tells the tasks apart in all {self.count} bodies; the best comes to "
                f"{float(worst.max()):.3f} nats"
            )
        return found

    def adapt(self, stage: RunStage, model: PEMIRLModel, shown: DemonstrationDataset) -> Any:
        """A policy trained on the rewards of single demonstrations in the changed dynamics."""
        torch.manual_seed(self.seed)
        given = self.settings.adaptation
        rollouts = max(1, given.rollouts // len(shown))
        env = self.in_changed(model, shown, rollouts, self.seed)
        policy, _ = initial_policy(model, given)
        optimization = PolicyOptimization(
            env,
            policy,
            model.horizon,
            given.optimization,
            rollouts_per_context=rollouts,
            reward=model.reward,
        )
        stage("adaptation", optimization)
        return policy

    # --- measuring

    def in_changed(
        self, model: PEMIRLModel, shown: DemonstrationDataset, episodes: int, seed: int
    ) -> EnvBase:
        """The changed dynamics, with the m of each demonstration and its task."""
        tasks = shown.tasks().exclude("body")
        infer = InferContext(
            model.encoder,
            shown.trajectories(),
            rollouts_per_context=episodes,
            draw="all",
            sample=False,
            tasks=tasks,
        )
        return self.env(self.changed, episodes * len(shown), infer, seed)

    def measure(
        self, model: PEMIRLModel, shown: DemonstrationDataset, actors: dict[str, Actor]
    ) -> dict[str, dict[str, float]]:
        """True and learned return of each actor in the changed dynamics, means over the tasks."""
        measured = {}
        for name, actor in actors.items():
            torch.manual_seed(0)
            env = self.in_changed(model, shown, EPISODES, seed=1000)
            rollouts = whole_episodes(env, actor, model.horizon)
            with torch.no_grad():
                learned = model.reward(rollouts.select(*model.reward.in_keys))["learned_reward"]
            measured[name] = {
                "true": float(rollouts["next", "reward"].sum((1, 2)).mean()),
                "learned": float(learned.sum((1, 2)).mean()),
            }
        return measured

    def knower(self, controller: Controller) -> Actor:
        """The best that is known in the changed dynamics, as something that acts."""

        def act(tensordict: TensorDictBase) -> TensorDictBase:
            seen = tensordict["observation"][:, : self.changed.observation_size]
            return tensordict.set("action", controller(seen, dict(tensordict["task"].items())))

        return act

    def run(self, stage: RunStage) -> dict[str, Any]:
        """Everything, and what came out."""
        each = max(1, self.family.demonstrations // self.count)
        data = self.demonstrate(self.family.split, self.count, each, self.seed)
        tasks, body = data.tasks(), data.tasks()["body"].argmax(-1)
        parameter = tasks[self.task.task_key]
        pairs = pair_by_task(data, self.numbers(data), body, seed=self.seed)
        model = self.train(stage, data, pairs)
        shown = self.demonstrate("test", 1, 1, 1000 + self.seed)
        adapted = self.adapt(stage, model, shown)
        actors: dict[str, Actor] = {
            "adapted": adapted,
            "carried_over": model.policy,
            "known": self.knower(self.family.known()),
            "random": None,
        }
        returns = self.measure(model, shown, actors)
        names = component_names(self.changed)
        true = {name: value["true"] for name, value in returns.items()}
        return {
            "reads": self.reads,
            "read": [names[i] for i in model.config.reward_features or ()],
            "bodies": self.count,
            "seed": self.seed,
            "gap_closed": gap_closed(true),
            "returns": returns,
            "contexts": self.probe(model, data, parameter),
            "demonstrations": len(data),
            "config": self.settings.resolved,
            **environment_facts(),
        }

    @torch.no_grad()
    def probe(
        self, model: PEMIRLModel, data: DemonstrationDataset, parameter: Tensor
    ) -> dict[str, float]:
        """How much of task and body a linear map reads off the means of q: R squared of each."""
        means = model.encoder.get_dist(data.trajectories()).mean
        even, odd = slice(0, None, 2), slice(1, None, 2)
        found = {"task": parameter}
        if self.count > 1:
            found["body"] = data.tasks()["body"]
        order = torch.randperm(len(means), generator=torch.Generator().manual_seed(0))
        return {
            name: linear_probe(
                means[order][even], value[order][even], means[order][odd], value[order][odd]
            )["r2"]
            for name, value in found.items()
        }


def report(stage: str, iteration: int, metrics: Any) -> None:
    """A line now and then."""
    if iteration % 20 == 0:
        told = ("return/true", "return/learned", "meta_il/loss_imitation")
        logging.info("%s %d %s", stage, iteration, {k: metrics[k] for k in told if k in metrics})


def gap_closed(true: Mapping[str, float]) -> float:
    """0 is the policy carried over, 1 the best that is known."""
    return (true["adapted"] - true["carried_over"]) / (true["known"] - true["carried_over"])


def main() -> None:
    """A result for each number of bodies and seed of the command line."""
    logging.basicConfig(level=logging.INFO, format="%(message)s", force=True)
    torch.set_num_threads(1)
    name, chosen, counts, *words = sys.argv[1:]
    if name not in FAMILIES or chosen not in get_args(Reads):
        sys.exit(f"got {name} {chosen}; expected one of {[*FAMILIES]}, one of {get_args(Reads)}")
    reads: Reads = "whole" if chosen == "whole" else "found"
    overrides = [word for word in words if "=" in word]
    folder = ROOT / f"results/transfer/several_bodies_{name}"
    for seed in map(int, [word for word in words if "=" not in word] or ["0"]):
        for count in map(int, counts.split(",")):
            run = f"{reads}_bodies{count}_seed{seed}"
            file = folder / f"{run}.json"
            if file.exists():
                continue
            experiment = Experiment(FAMILIES[name], reads, count, seed, *overrides)
            runs = ROOT / f"runs/several_bodies/{name}/{run}"
            result = experiment.run(stages(report, runs, f"{name}, {run}"))
            logging.info("%s: reads %s, gap closed %s", run, result["read"], result["gap_closed"])
            folder.mkdir(parents=True, exist_ok=True)
            with atomic_path(file) as temporary:
                temporary.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
