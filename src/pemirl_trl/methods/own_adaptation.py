"""A policy on the reward of one demonstration, in one call (Algorithm 2)."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from pemirl_trl.configuration import present_device
from pemirl_trl.data import DemonstrationDataset
from pemirl_trl.methods.candidates import Candidate, Start, candidates
from pemirl_trl.methods.consistency import doubts
from pemirl_trl.methods.defaults import Exploration
from pemirl_trl.methods.environments import Episodes, MakeEnv
from pemirl_trl.methods.inference import check_demonstrations
from pemirl_trl.methods.loop import Metrics
from pemirl_trl.methods.own_training import as_dataset, check_model, digest
from pemirl_trl.methods.policy_training import PolicyTraining
from pemirl_trl.methods.stages import OnIteration, RunStage, stages
from pemirl_trl.modules import PEMIRLModel
from pemirl_trl.modules.model import Policy
from pemirl_trl.sharing import save_policy

LOG = logging.getLogger("pemirl_trl")

TRY_SHARE = 1 / 6
"""Share of the iterations that each way is tried for; a deviation falls as in a whole run."""


@dataclass(frozen=True, eq=False)
class Adaptation:
    """A policy on learned rewards, and what there is to know about it. No true return is known.

    Attributes:
        policy: reads ``observation`` and the ``context`` of a demonstration.
        activation: of its hidden layers.
        kept: ``"adapted"``, or ``"carried over"`` where adaptation earned less than the policy that
            meta-training ended with, which is then the one returned.
        start: what adaptation started from.
        exploration: how widely it looked.
        tries: what short tries of all starts and explorations earned; empty where both were given.
        learned_return: of the policy: sum over an episode of r(s, m), mean over episodes of all
            demonstrations; mean action, the same episodes for all policies.
        carried_over_return: that of the policy that meta-training ended with.
        history: metrics of each iteration that this process did, without those of the tries.
        env_steps: environment steps of adaptation, tries included.
        warnings: what makes the result doubtful, in whole sentences.
        settings: a table of those that were found from the data.
    """

    policy: Policy
    activation: str
    kept: Literal["adapted", "carried over"]
    start: Start
    exploration: Exploration
    tries: Mapping[str, float]
    learned_return: float
    carried_over_return: float
    history: tuple[Metrics, ...]
    env_steps: int
    warnings: tuple[str, ...]
    settings: str

    def save(self, path: str | Path, metadata: Mapping[str, str] | None = None) -> None:
        """Write the policy to one safetensors file, for :func:`pemirl_trl.load_policy`.

        Raises:
            OSError: it cannot be written; the message names the file and says what to do.
        """
        facts = {**(metadata or {}), "env_steps": str(self.env_steps)}
        save_policy(path, self.policy, self.activation, facts)

    def __str__(self) -> str:
        """Return the learned returns and the warnings, one a line."""
        tries = ", ".join(f"{name} {value:.2f}" for name, value in self.tries.items())
        lines = [
            f"kept: {self.kept} (start: {self.start}, exploration: {self.exploration}"
            + (f"; tries: {tries})" if tries else ")"),
            f"learned return: {self.learned_return:.2f} (carried over: "
            f"{self.carried_over_return:.2f}), after {self.env_steps:,} environment steps",
            *(f"warning: {text}" for text in self.warnings),
        ]
        return "\n".join(lines)


def adapt(
    model: PEMIRLModel,
    demonstrations: DemonstrationDataset | str | Path,
    make_env: MakeEnv,
    *,
    seed: int = 0,
    device: str = "cpu",
    on_iteration: OnIteration | None = None,
    checkpoint: str | Path | None = None,
    observation_keys: Sequence[str] | None = None,
    exploration: Exploration | None = None,
    **overrides: Any,
) -> Adaptation:
    """Train a policy on the inferred reward of each demonstration, where dynamics may have changed.

    It starts afresh or from the policy that meta-training ended with, and explores widely or
    narrowly: whatever earns most under r in a short try. The policy that is returned never earns
    less under r than the one carried over.

    Args:
        model: encoder and reward, of :func:`meta_train` or :func:`pemirl_trl.load_model`.
        demonstrations: one of each new task; or the file of them.
        make_env: makes the environment to act in, as in :func:`meta_train`.
        seed: of everything random.
        device: of the learner, as in :func:`meta_train`.
        on_iteration: called with the stage's name, the iteration (from 1) and its metrics.
        checkpoint: folder of checkpoints; the same call resumes a training that died.
        observation_keys: as in :func:`meta_train`.
        exploration: ``"wide"`` or ``"narrow"``, instead of what tries choose.
        **overrides: fields of :class:`pemirl_trl.methods.AdaptationConfig`, nested ones as
            dictionaries: ``optimization={"iterations": 100}``. With ``initial_policy`` the other
            start is not tried.

    Raises:
        TypeError: something else than a model, such as the name of its file.
        ValueError: demonstrations or an environment that do not fit the model, before anything is
            trained; a wrong setting; or a checkpoint of another training.
        TrainingDiverged: a quantity exploded.
    """
    check_model(model, PEMIRLModel)
    data = as_dataset(demonstrations)
    ways = candidates(model, data, overrides, exploration)
    what = f"{ways} seed={seed} data={digest(data)}"
    run_stage = stages(on_iteration, checkpoint, hashlib.sha256(what.encode()).hexdigest())
    return adapt_in_stages(
        *(model, data, make_env, ways, run_stage),
        seed=seed,
        device=device,
        observation_keys=observation_keys,
    )


def adapt_in_stages(
    model: PEMIRLModel,
    demonstrations: DemonstrationDataset,
    make_env: MakeEnv,
    ways: Sequence[Candidate],
    run_stage: RunStage,
    *,
    seed: int,
    device: str = "cpu",
    observation_keys: Sequence[str] | None = None,
) -> Adaptation:
    """What :func:`adapt` does, with another way to run its stages.

    Args:
        model, demonstrations, make_env, seed, device, observation_keys: as there.
        ways: to adapt; of more than one, short tries choose.
        run_stage: runs ``"try-fresh-wide"`` and so on, and ``"adaptation"``.

    Raises:
        ValueError, TrainingDiverged: as there.
    """
    demonstrations = check_demonstrations(model, demonstrations)
    episodes = Episodes(make_env, model, demonstrations, seed, observation_keys=observation_keys)
    train = PolicyTraining(
        model, demonstrations, episodes, run_stage, ways[0].config, seed, present_device(device)
    )
    tries = _tries(ways, train)
    best = max(ways, key=lambda way: tries.get(way.name, 0.0))
    LOG.info("adaptation, %s, with\n%s", best.name, best.settings)
    carried = model.trained_policy(best.config.policy_scale)
    carried_return = train.learned_return(carried)
    policy, activation = train("adaptation", best.config)
    adapted_return = train.learned_return(policy)
    warnings = train.far_demonstrations()
    if model.family is not None:
        warnings += doubts(model.family)
    kept: Literal["adapted", "carried over"] = "adapted"
    if adapted_return < carried_return:
        kept, policy, activation = "carried over", carried, "relu"
        warnings.append(
            f"adaptation earned {adapted_return:.2f} under the learned reward and the policy "
            f"carried over {carried_return:.2f}: the latter is returned. More iterations, or "
            "another deviation (policy_scale), may help"
        )
    warnings += train.doubts(policy)
    return Adaptation(
        policy=policy,
        activation=activation,
        kept=kept,
        start=best.start,
        exploration=best.exploration,
        tries=tries,
        learned_return=max(adapted_return, carried_return),
        carried_over_return=carried_return,
        history=tuple(train.history["adaptation"]),
        env_steps=train.env_steps,
        warnings=tuple(warnings),
        settings=best.settings,
    )


def _tries(ways: Sequence[Candidate], train: PolicyTraining) -> dict[str, float]:
    """What a short training of each way earns; nothing where there is one way."""
    if len(ways) == 1:
        return {}
    earned = {}
    for way in ways:
        optimization = way.config.optimization
        iterations = max(1, round(TRY_SHARE * optimization.iterations))
        short = replace(way.config, optimization=replace(optimization, iterations=iterations))
        tried, _ = train(f"try-{way.name}", short)
        earned[way.name] = train.learned_return(tried)
    return earned
