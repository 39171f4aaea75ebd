"""One demonstration in, its reward out, by the commands: bodies of Gymnasium's.

``python examples/own_gymnasium/prove.py reacher 0 1 2`` writes
``results/own_tasks/reacher/seed<n>.json`` for each seed, and ``reacher_action_cost`` beside it,
where what actions cost is said beside the learned reward; ``half_cheetah`` is another body.
Demonstrations and what ``pemirl meta_train`` and ``pemirl adapt_reward`` write go to
``runs/own_tasks``, where nothing of that seed may be. True returns are for this report; no learner
reads them.
"""

from __future__ import annotations

import importlib
import json
import logging
import shlex
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import torch
from gymnasium_task import Expert
from tensordict import TensorDictBase
from torch import nn
from torchrl.envs import Transform, TransformedEnv

from pemirl_lab.measuring.own_proofs import (
    EPISODES,
    Proved,
    of_contexts,
    of_tasks,
    result,
    train_on_true_reward,
    without_tasks,
    words,
    write_results,
)
from pemirl_trl import (
    ContextPolicy,
    DemonstrationDataset,
    PEMIRLModel,
    Provenance,
    load_policy,
)
from pemirl_trl.evaluation import Actor, whole_episodes
from pemirl_trl.modules import Standardize
from pemirl_trl.modules.model import Policy
from pemirl_trl.pretrained import load_model

HERE, ROOT = Path(__file__).parent, Path(__file__).parents[2]
NEW = 10  # unseen tasks, with one demonstration each


class Proof:
    """The run of one task and one seed.

    Args:
        name: of the module beside this one.
        seed: of demonstrations and training.
        overrides: words for all commands, for a quick look.
    """

    def __init__(self, name: str, seed: int, overrides: tuple[str, ...] = ()) -> None:
        self.name, self.seed, self.overrides = name, seed, overrides
        self.task = importlib.import_module(name)
        self.folder = ROOT / "runs" / "own_tasks" / name / f"seed{seed}"
        self.folder.mkdir(parents=True)  # anew: seconds count
        self.horizon: int = self.environment(1, 0).base_env.task.horizon
        self.key = ("task", self.environment(1, 0).base_env.task.task_key)
        self.seconds: dict[str, float] = {}
        self.commands: list[str] = []

    def __call__(self) -> Iterator[Proved]:
        """Demonstrate, meta-train, adapt in each way; what it came to, in true returns per task."""
        before, after = self.timed("experts", lambda: self.task.experts(self.seed))
        pile = self.demonstrations(self.task.DEMONSTRATIONS, 10_000 + self.seed, before)
        new = self.demonstrations(NEW, 20_000 + self.seed, before)
        shown = without_tasks(pile)
        shown.save(self.folder / "train.safetensors")
        without_tasks(new).save(self.folder / "new.safetensors")
        self.timed("meta_training", self.meta_train)
        model = load_model(self.folder / "trained" / "model.safetensors")
        oracle = self.timed("rl_with_true_reward", lambda: self.oracle(model, new))
        known = of_tasks(new)
        inferred = of_contexts(model, new)
        scores = {
            "expert": self.score(known, after),
            "random": self.score(known, None),
            "carried_over": self.score(inferred, model.policy),
            "rl_with_true_reward": self.score(known, oracle),
            "one_shot": self.score(inferred, model.policy, changed=False),
            "expert_before": self.score(known, before, changed=False),
        }
        trained = [*self.commands]
        for name, settings in self.task.ADAPTATIONS.items():
            self.commands = [*trained]
            self.timed("adaptation", partial(self.adapt_reward, name, settings))
            adapted = load_policy(self.folder / name / "policy.safetensors", model)
            found = self.report(name, {**scores, "adapted": self.score(inferred, adapted)})
            yield Proved(found, model, shown, {"words": [*self.task.SETTINGS]})

    def report(self, name: str, scores: dict[str, dict[str, list[float]]]) -> dict[str, Any]:
        """The result of one adaptation, as it is stored."""
        returns = {name: score["return"] for name, score in scores.items()}
        terms = {
            term: {name: sum(score[term]) / NEW for name, score in scores.items()}
            for term in scores["adapted"]
            if term != "return"
        }
        means = {name: sum(each) / len(each) for name, each in returns.items()}
        adaptation = json.loads((self.folder / name / "adaptation.json").read_text("utf-8"))
        return result(
            *(name, self.seed, means),
            terms=terms,
            per_target=returns,
            commands=self.commands,
            adaptation=adaptation,
            seconds=dict(self.seconds),
        )

    def timed(self, stage: str, act: Callable[[], Any]) -> Any:
        """What the stage returns; its seconds are noted."""
        began = time.perf_counter()
        returned = act()
        self.seconds[stage] = time.perf_counter() - began
        logging.info("%s seed %d: %s %.0f s", self.name, self.seed, stage, self.seconds[stage])
        return returned

    def demonstrations(self, n: int, seed: int, expert: Expert) -> DemonstrationDataset:
        """One demonstration of each of so many tasks, with noise on the actions."""
        env, generator = self.task.make_env(n, seed), torch.Generator().manual_seed(seed + 1)
        low, high = env.task.action_bounds

        @torch.no_grad()
        def act(td: TensorDictBase) -> TensorDictBase:
            action = expert(td)["action"]  # the mean, of a policy: nothing explores here
            noise = self.task.NOISE * torch.randn(action.shape, generator=generator)
            return td.set("action", (action + noise).clamp(low, high))

        rollouts = env.rollout(self.horizon, act)
        return DemonstrationDataset.from_rollouts(rollouts, Provenance(self.name, seed))

    def meta_train(self) -> None:
        """``pemirl meta_train``."""
        self.pemirl(
            "meta_train",
            f"demonstrations={self.folder / 'train.safetensors'}",
            f"env={self.name}:make_env",
            f"run_dir={self.folder / 'trained'}",
            *self.task.SETTINGS,
        )

    def adapt_reward(self, name: str, settings: dict[str, Any]) -> None:
        """``pemirl adapt_reward``, in a folder of that name."""
        self.pemirl(
            "adapt_reward",
            f"model_file={self.folder / 'trained' / 'model.safetensors'}",
            f"test_demonstrations={self.folder / 'new.safetensors'}",
            f"env={self.name}:make_changed_env",
            f"run_dir={self.folder / name}",
            *words(settings),
        )

    def pemirl(self, command: str, *words: str) -> None:
        """Run a command where this task's module can be imported."""
        given = [command, *words, f"seed={self.seed}", *self.overrides]
        said = shlex.join(["pemirl", *given]).replace(f"{self.folder}/", "")
        self.commands.append(said)
        subprocess.run([sys.executable, "-m", "pemirl_lab.cli", *given], cwd=HERE, check=True)

    def environment(self, n: int, seed: int, *transforms: Transform, changed: bool = True) -> Any:
        """Environments whose reward is the true one of what the transform resets to."""
        make = self.task.make_changed_env if changed else self.task.make_env
        return TransformedEnv(make(n, seed), *transforms)

    def score(
        self, transform: Transform, actor: Actor, *, changed: bool = True
    ) -> dict[str, list[float]]:
        """True returns and their terms, one a task: the mean action, the same episodes for all."""
        torch.manual_seed(0)
        env = self.environment(NEW * EPISODES, 30_000, transform.clone(), changed=changed)
        rollouts = whole_episodes(env, actor, self.horizon)
        task = env.base_env.task
        action = rollouts["action"].clamp(*task.action_bounds)
        terms = task.terms(rollouts["observation"], action, rollouts[self.key])
        parts = {"return": rollouts["next", "reward"], **terms}
        return {
            name: part.sum((1, 2)).view(NEW, EPISODES).mean(1).tolist()
            for name, part in parts.items()
        }

    def oracle(self, model: PEMIRLModel, new: DemonstrationDataset) -> Policy:
        """A policy that reads the task, on the true reward, with adaptation's own settings."""
        standardize_task = Standardize.fit(new.tasks()[self.key[1]])
        return train_on_true_reward(
            *(model, new),
            lambda scale, learned: ContextPolicy(
                *(new.observation_dim, new.action_dim, standardize_task.features),
                activation=nn.Tanh,
                standardize=model.standardize,
                initial_scale=scale,
                learn_scale=learned,
                standardize_context=standardize_task,
                context_key=self.key,
            ),
            self.environment,
            self.seed,
            reward=self.environment(1, 0).base_env.task.true_reward,
            reads=("observation", "action", self.key),
        )


def main() -> None:
    """Results for each seed of the command line."""
    write_results(ROOT, lambda seed: Proof(sys.argv[1], seed)(), sys.argv[2:])


if __name__ == "__main__":
    main()
