"""Draw demonstrations at reset, infer their context, hold it through the rollout."""

from __future__ import annotations

from typing import Literal, Protocol, get_args

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import ProbabilisticTensorDictSequential
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Composite, Unbounded
from torchrl.envs import Transform

from pemirl_trl.modules.reading import ENCODER, read, shown_of, trajectories_of

Draw = Literal["random", "all"]


class TrajectorySource(Protocol):
    """What gives trajectories, such as :class:`pemirl_trl.DemonstrationDataset`."""

    def trajectories(self) -> TensorDictBase:
        """Return them with batch size ``[J]`` and leaves ``[J, T, ...]``."""


class InferContext(Transform):
    """Write ``context`` m ~ q_psi(m | demonstration) at reset; every step of a rollout carries it.

    The N environments are M groups of K: those of a group share one demonstration and one m
    (context-major order). Each full reset draws anew and uses the encoder's weights of that moment.
    Draws are from torch's global generator (``torch.manual_seed``), not from the environment's.
    A masked reset draws for the masked groups only, and a group resets as a whole.

    Where ``tasks`` are given, the environment is reset to the task of the drawn demonstration, so
    that its own reward is the true one of that task: a metric. The learner never sees them: they
    reach the environment's reset, and no key that a network reads.

    Writes ``context`` ``[N, D]`` and ``demonstration`` ``[N]`` (the index drawn). Source: Algorithm
    1 of Yu, Yu, Finn and Ermon (2019), "Meta-Inverse Reinforcement Learning with Probabilistic
    Context Variables", arXiv:1909.09314.

    Args:
        encoder: q_psi; needs ``get_dist`` and ``context_dim``.
        demonstrations: batch size ``[J]``, leaves ``[J, T, ...]``, with the encoder's input keys;
            or a :class:`pemirl_trl.DemonstrationDataset`, of which the trajectories are taken, and
            not the tasks: give these by ``tasks``.
        rollouts_per_context: K.
        draw: ``"random"``: M of the J demonstrations, uniformly and with replacement;
            ``"all"``: each of them, in order, which needs N = J K.
        sample: whether m is drawn from q or its mean.
        tasks: batch size ``[J]``, the environment's task parameters; optional.
        context_key, index_key: where m and the index are written.
        task_key: where the environment reads them at reset.

    Raises:
        TypeError: no encoder was given.
        ValueError: an unknown draw, or other than J tasks; at reset, environments that do not
            divide into contexts, or a masked reset of a part of a group.

    Example:
        >>> from torchrl.envs import GymEnv, TransformedEnv
        >>> from pemirl_trl import ContextEncoder, DemonstrationDataset
        >>> demonstrations = DemonstrationDataset(torch.randn(8, 11, 3), torch.randn(8, 10, 1))
        >>> infer = InferContext(ContextEncoder(3, 1, 2, horizon=10), demonstrations)
        >>> env = TransformedEnv(GymEnv("Pendulum-v1"), infer)
        >>> env.rollout(10)["context"].shape
        torch.Size([10, 2])
    """

    def __init__(
        self,
        encoder: ProbabilisticTensorDictSequential,
        demonstrations: TensorDictBase | TrajectorySource,
        *,
        rollouts_per_context: int = 1,
        draw: Draw = "random",
        sample: bool = True,
        tasks: TensorDictBase | None = None,
        context_key: NestedKey = "context",
        index_key: NestedKey = "demonstration",
        task_key: str = "task",
    ) -> None:
        if draw not in get_args(Draw):
            raise ValueError(f"unknown draw {draw!r}; choose one of {get_args(Draw)}")
        ENCODER.required(encoder, "InferContext")
        demonstrations = trajectories_of(demonstrations)
        if tasks is not None and tasks.batch_size[:1] != demonstrations.batch_size[:1]:
            raise ValueError(
                f"got {demonstrations.batch_size[0]} demonstrations and {tasks.batch_size[0]} tasks"
            )
        super().__init__(in_keys=[], out_keys=[context_key, index_key])
        self.encoder = encoder
        self.rollouts_per_context = rollouts_per_context
        self.draw, self.sample = draw, sample
        self.context_key, self.index_key, self.task_key = context_key, index_key, task_key
        # Data, not state: kept out of the environment's state_dict.
        self.__dict__["_demonstrations"] = demonstrations
        self.__dict__["_tasks"] = tasks
        self.__dict__["_index"] = None
        self.__dict__["_context"] = None

    @property
    def knows_tasks(self) -> bool:
        """Whether the environment is reset to the demonstrated tasks.

        Where it is not, the environment's own reward is that of some other task: no metric.
        """
        return self._tasks is not None

    def _reset_env_preprocess(self, tensordict: TensorDictBase | None) -> TensorDictBase | None:
        """Draw before the environment resets, so that it can reset to the drawn tasks."""
        rollouts = self.parent.batch_size.numel()
        mask = None if tensordict is None else tensordict.get("_reset", None)
        self._draw(rollouts, None if mask is None else mask.view(rollouts))
        if self._tasks is not None:
            if tensordict is None:
                tensordict = TensorDict({}, self.parent.batch_size)
            tensordict = tensordict.copy().set(self.task_key, self._tasks[self._index])
        return tensordict

    def _draw(self, rollouts: int, mask: Tensor | None) -> None:
        contexts, rest = divmod(rollouts, self.rollouts_per_context)
        count = self._demonstrations.batch_size[0]
        if rest or (self.draw == "all" and contexts != count):
            raise ValueError(
                f"{rollouts} environments do not hold {self.rollouts_per_context} rollouts of "
                + (f"each of {count} demonstrations" if self.draw == "all" else "each context")
            )
        drawn = torch.arange(count) if self.draw == "all" else torch.randint(count, (contexts,))
        index = drawn.repeat_interleave(self.rollouts_per_context)
        context = self._infer(drawn).repeat_interleave(self.rollouts_per_context, 0)
        if mask is not None and self._index is not None and not mask.all():
            groups = mask.view(contexts, self.rollouts_per_context)
            if not torch.equal(groups.any(1), groups.all(1)):
                raise ValueError(
                    f"a masked reset must take all {self.rollouts_per_context} rollouts of a "
                    "context or none, since they share it"
                )
            index = torch.where(mask, index, self._index)
            context = torch.where(mask.unsqueeze(-1), context, self._context)
        self.__dict__["_index"], self.__dict__["_context"] = index, context

    @torch.no_grad()
    def _infer(self, index: Tensor) -> Tensor:
        posterior = self.encoder.get_dist(shown_of(self._demonstrations)[index])
        return posterior.sample() if self.sample else posterior.mean

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        if self._tasks is not None:
            self._check_tasks(tensordict_reset)
        context = self._context.view(*self.parent.batch_size, -1)
        index = self._index.view(self.parent.batch_size)
        return tensordict_reset.set(self.context_key, context).set(self.index_key, index)

    def _check_tasks(self, tensordict_reset: TensorDictBase) -> None:
        """Raise unless the environment says that it has taken the tasks that it was reset to."""
        taken = tensordict_reset.get(self.task_key, None)
        given = self._tasks[self._index]
        if taken is None:
            raise ValueError(
                f"tasks were given, but the environment's reset writes no {self.task_key!r}: it "
                "may not have read them. An environment that takes its task at reset writes it "
                "back; for one that does not, give no tasks (its reward is then no metric)"
            )
        for key, value in given.items(include_nested=True, leaves_only=True):
            there = taken.get(key, None)
            if there is None or not torch.equal(there.reshape(value.shape), value.to(there.dtype)):
                raise ValueError(
                    f"the environment did not take the tasks that it was reset to: its "
                    f"({self.task_key!r}, {key!r}) is another. Tasks reach a batched environment "
                    "at its own reset alone: SerialEnv and ParallelEnv do not hand them on"
                )

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        for key in (self.context_key, self.index_key):
            next_tensordict.set(key, read(tensordict, key, "InferContext", "context"))
        return next_tensordict

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the context and the demonstration's index."""
        shape, device = observation_spec.shape, observation_spec.device
        weights = next(self.encoder.parameters(), torch.empty(0))  # without any: torch's default
        observation_spec[self.context_key] = Unbounded(
            (*shape, self.encoder.context_dim), device=device, dtype=weights.dtype
        )
        observation_spec[self.index_key] = Unbounded(shape, device=device, dtype=torch.int64)
        return observation_spec
