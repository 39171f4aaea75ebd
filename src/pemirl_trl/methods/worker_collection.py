"""One training's rollouts from several processes of Ray, on this machine or on many.

What a worker collects is a function of the weights and seeds that it is sent. A worker that dies is
therefore started anew by Ray, collects its share of the batch again, and nobody sees a difference
but in time. TorchRL's own Ray collector loses the training with the worker (docs/cluster.md).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

from pemirl_trl.methods.collection import Collection, EpisodeCollector
from pemirl_trl.modules import PEMIRLModel
from pemirl_trl.modules.network import device_of

MakeShare = Callable[[PEMIRLModel, int], EnvBase]
"""(model, contexts) -> the environment of so many contexts, whose ``InferContext`` has the model's
encoder. It is sent to the workers: a function of a module, or ``functools.partial`` of one."""

_RETRIES = 3
"""How often one share is collected anew before its workers' deaths count as the training's."""


class Share:
    """What a worker does, in a process of its own: a part of every batch.

    Args:
        make_env: see :data:`MakeShare`.
        model: encoder and policy; a copy for this worker, on the CPU.
        contexts: of its part.
    """

    def __init__(self, make_env: MakeShare, model: PEMIRLModel, contexts: int) -> None:
        torch.set_num_threads(1)  # sums depend on it
        self._model = model
        self._collect = EpisodeCollector(make_env(model, contexts), model.policy, model.horizon)

    def facts(self) -> tuple[int, bool]:
        """Environment steps of one call, and whether the environment knows the tasks."""
        return self._collect.frames, self._collect.knows_tasks

    def collect(
        self, weights: Mapping[str, Tensor], env_seed: int, torch_seed: int
    ) -> TensorDictBase:
        """Rollouts of these weights and seeds, whatever was collected before."""
        self._model.load_state_dict(weights)
        self._collect.env.set_seed(env_seed)
        torch.manual_seed(torch_seed)
        return self._collect()


class WorkerCollector(Collection):
    """Whole episodes from several workers, for the place of a method's environment.

    Weights of encoder and policy go to the workers before each batch; their seeds are drawn from
    torch's global generator. Rollouts depend on how many workers there are, and not on when or
    where they run, or how often they die. The cluster is that of the variable ``RAY_ADDRESS``, or
    one of this machine's.

    Args:
        make_env: see :data:`MakeShare`.
        model: as it is trained, on any device.
        shares: contexts of each worker.
        cpus: that one worker takes.

    Raises:
        ImportError: Ray is not installed; says how to install it.
        ValueError: more workers than the cluster has CPUs for, or an environment that cannot be
            trained on.
    """

    def __init__(
        self, make_env: MakeShare, model: PEMIRLModel, shares: Sequence[int], *, cpus: int = 1
    ) -> None:
        self._ray, self._model = _cluster(len(shares) * cpus), model
        worker = self._ray.remote(num_cpus=cpus, max_restarts=-1, max_task_retries=_RETRIES)(Share)
        # Kept: a worker is made anew of them.
        self._sent = self._ray.put(make_env), self._ray.put(deepcopy(model).cpu())
        self._workers = [worker.remote(*self._sent, contexts) for contexts in shares]
        facts = self._ray.get([worker.facts.remote() for worker in self._workers])
        super().__init__(
            frames=sum(frames for frames, _ in facts), knows_tasks=all(knows for _, knows in facts)
        )

    def _batch(self) -> TensorDictBase:
        weights = {name: value.cpu() for name, value in self._model.state_dict().items()}
        sent = self._ray.put(weights)
        seeds = torch.randint(2**31, (len(self._workers), 2)).tolist()
        shares = self._ray.get(
            [
                worker.collect.remote(sent, *pair)
                for worker, pair in zip(self._workers, seeds, strict=True)
            ]
        )
        return torch.cat(shares).to(device_of(self._model))

    def close(self) -> None:
        """End the workers."""
        for worker in self._workers:
            self._ray.kill(worker)


def shares_of(contexts: int, workers: int) -> list[int]:
    """Divide ``contexts`` among ``workers``, as evenly as they go.

    Raises:
        ValueError: fewer contexts than workers.
    """
    if contexts < workers:
        raise ValueError(f"got {workers} workers for {contexts} contexts; expected at most as many")
    each, rest = divmod(contexts, workers)
    return [each + (worker < rest) for worker in range(workers)]


def _cluster(cpus: int) -> Any:
    """Ray, connected, with as many CPUs as are wanted: it would wait for others for ever."""
    try:
        import ray
    except ImportError as error:
        raise ImportError(
            'workers are processes of Ray, which is not installed: pip install "pemirl-trl[ray]"'
        ) from error
    if not ray.is_initialized():
        ray.init(include_dashboard=False)
    there = int(ray.cluster_resources().get("CPU", 0))
    if there < cpus:
        raise ValueError(
            f"the workers take {cpus} CPUs (workers x threads), and this Ray cluster has {there}"
        )
    return ray
