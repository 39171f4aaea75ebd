"""What a reward may read where the dynamics change, found in demonstrations by several bodies."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from numpy.typing import ArrayLike
from torch import Tensor
from torch.nn.functional import one_hot

from pemirl_trl.data import DemonstrationDataset, pair_by_task
from pemirl_trl.evaluation.joint_information import joint_information
from pemirl_trl.evaluation.task_space import agreed_contexts, held_out_information
from pemirl_trl.methods.defaults import meta_training_config
from pemirl_trl.methods.meta_il import MetaIL
from pemirl_trl.methods.meta_training import new_model
from pemirl_trl.methods.stages import OnIteration, stages
from pemirl_trl.modules import PEMIRLModel

__all__ = ["TaskSpace", "find_task_space"]


@dataclass(frozen=True, eq=False)
class TaskSpace:
    """What each component of an observation tells of the task in a body that was left out.

    Attributes:
        components: those that tell something in every body: what a reward may read where the
            dynamics change, ``task_space`` of :func:`pemirl_trl.meta_train`. The best comes first.
        whole: ``[bodies]``, what the whole state tells there
            (:func:`pemirl_trl.evaluation.joint_information`). Below 0 in a body, a reward of the
            whole state reads what is that body's own, and is not to be trusted under others.
        nats: ``[bodies, S]``, a step; below 0: what it meant in the other bodies misleads here.
        model: Meta-IL's, on the pairs: its encoder gave m.
    """

    components: list[int]
    whole: Tensor
    nats: Tensor
    model: PEMIRLModel

    @property
    def worst(self) -> Tensor:
        """The least that a component tells in any body, ``[S]``."""
        return self.nats.min(0).values


def find_task_space(
    demonstrations: Sequence[DemonstrationDataset],
    task_of: Sequence[ArrayLike] | None = None,
    *,
    settings: Mapping[str, Any] | None = None,
    seed: int = 0,
    on_iteration: OnIteration | None = None,
) -> TaskSpace:
    """Find what the task is about from pairs of demonstrations: of one task, by two bodies.

    Demonstrations under one dynamics do not say which part of the state was meant, and neither do
    unlabelled ones under several. Whoever knows that two demonstrations are of the *same* task
    says enough, without knowing which task that is, or why they are alike: m is inferred from the
    one and has to explain the other, so that it holds what they have in common; and what a
    component says of m in some bodies is asked of the body that was left out
    (:func:`pemirl_trl.evaluation.held_out_information`). One component is looked at a time: what
    only several of them together tell, a distance between two things say, is not found.

    Args:
        demonstrations: of each body, with the same components and the same length.
        task_of: of each body, a number for each demonstration: equal ones are of the same task.
            None: demonstration i of every body is of the same task.
        settings: of :func:`meta_train` to replace, such as ``{"meta_il": {"steps": 1500}}``.
        seed: of networks and draws.
        on_iteration: called after each hundred steps of Meta-IL.

    Raises:
        ValueError: fewer than two bodies, other sizes or lengths; or a task that one body alone has
            demonstrated.
    """
    _check(demonstrations)
    counts = [len(data) for data in demonstrations]
    if task_of is None:
        if len(set(counts)) > 1:
            raise ValueError(
                f"the bodies have {counts} demonstrations; expected equal numbers, demonstration i "
                "of each being of the same task, or task_of, which says what is of which task"
            )
        task_of = [torch.arange(count) for count in counts]
    tasks = torch.cat([torch.as_tensor(task) for task in task_of])
    body = torch.arange(len(counts)).repeat_interleave(torch.tensor(counts))
    size = demonstrations[0].observation_dim
    told = _joined(demonstrations, one_hot(body, len(counts)).float())
    torch.manual_seed(seed)
    pairs = pair_by_task(told, tasks, body, seed=seed)
    config = meta_training_config(told, "contrastive", settings)
    model = new_model(told, replace(config, reward_reads="observation"))
    run = stages(on_iteration, None, "find_task_space")
    run("meta-il", MetaIL(model, pairs.trajectories, config.meta_il))
    trajectories = told.trajectories()
    with torch.no_grad():
        means = model.encoder.get_dist(trajectories).mean
    shown = trajectories["observation"][..., :size], agreed_contexts(means, tasks, body), body
    nats = held_out_information(*shown, generator=torch.Generator().manual_seed(seed))
    generator = torch.Generator().manual_seed(seed)
    whole = joint_information(*shown, [range(size)], generator=generator)
    worst = nats.min(0).values
    order = worst.argsort(descending=True)
    return TaskSpace(order[worst[order] > 0].tolist(), whole[:, 0], nats, model)


def _check(demonstrations: Sequence[DemonstrationDataset]) -> None:
    if len(demonstrations) < 2:
        raise ValueError(
            f"got demonstrations of {len(demonstrations)} body; expected those of two or more"
        )
    sizes = [(data.observation_dim, data.action_dim, data.horizon) for data in demonstrations]
    if len(set(sizes)) > 1:
        raise ValueError(
            f"the bodies' demonstrations have (S, A, T) = {sizes}; expected one size of all"
        )
    if any((data.lengths < data.horizon).any() for data in demonstrations):
        raise ValueError("got demonstrations of several lengths; expected one length of all")


def _joined(demonstrations: Sequence[DemonstrationDataset], code: Tensor) -> DemonstrationDataset:
    """All of them, each observation followed by which body it is of: a policy has to know that."""
    observation = torch.cat([data.observation for data in demonstrations])
    told = code.unsqueeze(1).expand(-1, observation.shape[1], -1)
    action = torch.cat([data.action for data in demonstrations])
    return DemonstrationDataset(torch.cat([observation, told], -1), action)
