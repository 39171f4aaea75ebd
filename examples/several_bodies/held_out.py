"""How many bodies must have demonstrated, before the reward's components can be told from them?

    python examples/several_bodies/held_out.py 0 1 2

Demonstrations of ants with one to eight bodies, none of them that of ``ant/disabled``. For every
component of an observation: what it says about the direction by itself in the bodies that it was
fitted to, and in one that was left out (:func:`pemirl_trl.evaluation.held_out_information`). Writes
``results/transfer/ant_bodies/seedN.json``; the numbers are on docs/transfer.md.
"""

from __future__ import annotations

import json
import logging
import sys
from pathlib import Path
from typing import Any

import torch
from families import component_names
from mirror import MirroredPolicy, X, Y
from tensordict import TensorDict
from torch import Tensor

from pemirl_envs import TaskEnv
from pemirl_envs.tasks.ant import Ant
from pemirl_lab.measuring.experts import load_expert
from pemirl_lab.results import environment_facts
from pemirl_trl.evaluation import held_out_information
from pemirl_trl.files import atomic_path

ROOT = Path(__file__).parents[2]
EACH = 12  # demonstrations of each direction and body
# In the order in which they join: the expert of a variant, its disabled legs, and mirrors.
BODIES = (
    ("normal", (), ()),
    ("disabled_left_first", (2, 3), ()),
    ("disabled_diagonal", (1, 3), ()),
    ("disabled_one", (2,), ()),
    ("disabled_left_first", (2, 3), (X,)),
    ("disabled_diagonal", (1, 3), (X,)),
    ("disabled_one", (2,), (X,)),
    ("disabled_one", (2,), (Y,)),
)


@torch.no_grad()
def demonstrate(seed: int) -> tuple[Tensor, Tensor, Tensor, list[dict[str, Any]]]:
    """Observations ``[J, T, 27]``, directions ``[J, 1]``, bodies ``[J]``, and what they return."""
    torch.manual_seed(seed)
    observations, directions, bodies, facts = [], [], [], []
    for index, (expert, legs, mirrors) in enumerate(BODIES):
        for mirror in mirrors:
            legs = mirror.disabled(legs)
        task = Ant(disabled=legs)
        env = TaskEnv(task, 2 * EACH, seed=seed, num_threads=1)
        tasks = TensorDict(task.task_set("train"), [2]).repeat_interleave(EACH)
        policy = load_expert(str(ROOT / f"data/ant_{expert}_expert.safetensors"))
        rollouts = env.rollout(
            task.horizon,
            MirroredPolicy(policy, mirrors),
            auto_reset=False,
            tensordict=env.reset(task=tasks),
            break_when_any_done=False,
        )
        observations.append(rollouts["observation"].clone())
        directions.append(tasks["direction"])
        bodies.append(torch.full((2 * EACH,), index))
        returns = rollouts["next", "reward"].sum((1, 2)).view(2, EACH).mean(1)
        facts.append({"disabled": list(legs), "expert": expert, "returns": returns.tolist()})
        logging.info("legs %s disabled: %.0f and %.0f", legs or "none", *returns.tolist())
    return torch.cat(observations), torch.cat(directions), torch.cat(bodies), facts


def run(seed: int) -> dict[str, Any]:
    """Worst and mean held-out information of each component, after 2, 4 and 8 bodies."""
    observations, directions, bodies, facts = demonstrate(seed)
    names, families = component_names(Ant()), {}
    for count in (2, 4, 8):
        seen = bodies < count
        information = held_out_information(
            *(observations[seen], directions[seen], bodies[seen]),
            generator=torch.Generator().manual_seed(seed),
        )
        worst = information.min(0).values
        best = worst.argsort(descending=True)
        families[str(count)] = {
            names[i]: {"worst": float(worst[i]), "mean": float(information[:, i].mean())}
            for i in best.tolist()
        }
        first = list(families[str(count)].items())[:3]
        logging.info("%d bodies: %s", count, {k: round(v["worst"], 3) for k, v in first})
    return {"seed": seed, "bodies": facts, "families": families, **environment_facts()}


def main() -> None:
    """A result for each seed of the command line."""
    logging.basicConfig(level=logging.INFO, format="%(message)s", force=True)
    torch.set_num_threads(1)
    for seed in map(int, sys.argv[1:] or ["0"]):
        result = run(seed)
        file = ROOT / f"results/transfer/ant_bodies/seed{seed}.json"
        file.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(file) as temporary:
            temporary.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
