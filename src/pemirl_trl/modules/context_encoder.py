"""The inference model q_psi(m | trajectory), a diagonal Gaussian over the context.

An encoder returns a distribution (``get_dist``); sampling is the caller's act. Trajectories come
with batch size ``[N]`` and leaves ``[N, T, ...]``, since an encoder reduces time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from tensordict import TensorDictBase, is_tensor_collection
from tensordict.nn import (
    ProbabilisticTensorDictModule,
    ProbabilisticTensorDictSequential,
)
from tensordict.utils import NestedKey
from torch import Tensor, nn
from torch.distributions import Independent, Normal

from pemirl_trl.modules.direct import DirectModule
from pemirl_trl.modules.network import RowwiseMLP
from pemirl_trl.modules.reading import trajectories_of
from pemirl_trl.modules.standardize import Standardize


class _DrawnOnCPU(Normal):
    """Draws with the CPU's generator for parameters elsewhere: a seed means one noise."""

    def rsample(self, sample_shape: Any = ()) -> Tensor:
        noise = torch.randn(self._extended_shape(sample_shape), dtype=self.loc.dtype)
        return self.loc + noise.to(self.loc.device) * self.scale

    @torch.no_grad()
    def sample(self, sample_shape: Any = ()) -> Tensor:
        return self.rsample(sample_shape)


def diagonal_normal(loc: Tensor, scale: Tensor) -> Independent:
    """Return N(loc, diag(scale^2)) with event dimension D, for ``[..., D]`` arguments.

    It is drawn from with the CPU's generator, also where the arguments are on another device.
    """
    kind = Normal if loc.device.type == "cpu" else _DrawnOnCPU
    return Independent(kind(loc, scale, validate_args=False), 1, validate_args=False)


def valid_inputs(mask: Tensor | None, *parts: Tensor) -> tuple[Tensor, Tensor]:
    """What a network reads of steps, ``[N, T, F]`` with zeros for padding, and the mask ``[N, T]``.

    It is selected rather than multiplied, before the network as well as after: padding may hold
    NaN, which a zero gradient times the input would carry into the weights' gradient.

    Args:
        mask: True for valid steps; None: all are.
        parts: ``[N, T, ...]``, which are put together.

    Raises:
        ValueError: a trajectory has no valid step.
    """
    steps = torch.cat(parts, -1)
    if mask is None:
        return steps, torch.ones_like(steps[..., 0], dtype=torch.bool)
    if not mask.any(-1).all():
        raise ValueError("a trajectory has no valid step: its mask is False everywhere")
    return torch.where(mask.unsqueeze(-1), steps, 0.0), mask


class GaussianHead(nn.Module):
    """Splits features into a location and a scale, with one scale for all inputs if so told."""

    def __init__(
        self, context_dim: int, scale_depends_on_input: bool, initial_scale: float
    ) -> None:
        super().__init__()
        self.context_dim = context_dim
        self.depends = scale_depends_on_input
        self.log_scale = nn.Parameter(torch.full((context_dim,), initial_scale).log())

    @property
    def in_features(self) -> int:
        """How many features it takes."""
        return self.context_dim * (2 if self.depends else 1)

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Features ``[..., in_features]`` as location and scale, ``[..., D]``."""
        loc = features[..., : self.context_dim]
        log_scale = self.log_scale.expand_as(loc)
        if self.depends:
            log_scale = log_scale + features[..., self.context_dim :]
        return loc, log_scale.exp()


class _FlatTrajectoryNet(nn.Module):
    def __init__(
        self, net: nn.Module, head: GaussianHead, standardize: Standardize, horizon: int
    ) -> None:
        super().__init__()
        self.standardize, self.net, self.head, self.horizon = standardize, net, head, horizon

    def forward(self, observation: Tensor, *action: Tensor) -> tuple[Tensor, Tensor]:
        if observation.shape[-2] != self.horizon:
            raise ValueError(
                f"this encoder takes trajectories of exactly {self.horizon} steps, got "
                f"{observation.shape[-2]}; for other lengths use MaskedContextEncoder"
            )
        steps = torch.cat([self.standardize(observation), *action], -1)
        return self.head(self.net(steps.flatten(-2)))


class _MaskedTrajectoryNet(nn.Module):
    def __init__(
        self, step_net: nn.Module, net: nn.Module, head: GaussianHead, standardize: Standardize
    ) -> None:
        super().__init__()
        self.standardize, self.step_net, self.net, self.head = standardize, step_net, net, head

    def forward(
        self, observation: Tensor, mask: Tensor | None, *action: Tensor
    ) -> tuple[Tensor, Tensor]:
        inputs, mask = valid_inputs(mask, self.standardize(observation), *action)
        valid = mask.unsqueeze(-1)
        steps = self.step_net(inputs)
        mean = torch.where(valid, steps, 0.0).sum(-2) / mask.sum(-1, keepdim=True)
        return self.head(self.net(mean))


class GaussianContext(ProbabilisticTensorDictSequential):
    """A network that gives (loc, scale), followed by the Gaussian over the context.

    Args:
        net: takes observations, the mask if there is a ``mask_key``, and actions if it reads them.
        context_dim: D.
        context_key: where the sample is written.
        mask_key: where a mask may stand; None: the network takes none.
        reads_actions: whether the network takes actions.
    """

    def __init__(
        self,
        net: nn.Module,
        context_dim: int,
        context_key: NestedKey,
        *,
        mask_key: NestedKey | None = None,
        reads_actions: bool = True,
    ) -> None:
        loc_key, scale_key = "context_loc", "context_scale"
        optional: tuple[NestedKey, ...] = ()
        if mask_key is not None:
            self.mask_key = mask_key
            optional = (mask_key,)
        in_keys: list[NestedKey] = ["observation", *optional]
        if reads_actions:
            self.action_key: NestedKey = "action"
            in_keys.append("action")
        super().__init__(
            DirectModule(net, in_keys, [loc_key, scale_key], optional, reader=type(self).__name__),
            ProbabilisticTensorDictModule(
                in_keys={"loc": loc_key, "scale": scale_key},
                out_keys=[context_key],
                distribution_class=diagonal_normal,
            ),
        )
        self.context_dim, self.reads_actions = context_dim, reads_actions
        self.observation_key: NestedKey = "observation"
        self.context_key = context_key
        self.loc_key, self.scale_key = loc_key, scale_key

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """Call the module; a data set is taken for its trajectories."""
        if args:
            args = (self._trajectories(args[0]), *args[1:])
        return super().__call__(*args, **kwargs)

    def get_dist(self, tensordict: TensorDictBase, **kwargs: object) -> Independent:
        """Return q(m | trajectory), with batch size ``[N]`` and event size ``[D]``.

        Args:
            tensordict: trajectories, batch size ``[N]`` and leaves ``[N, T, ...]``, or a data set
                with a method ``trajectories``; left unchanged.
            **kwargs: of TensorDict's method.

        Raises:
            MissingKeyError: it lacks one of ``in_keys``.
            ValueError: its batch size has the time, or flattens it.
        """
        return super().get_dist(self._trajectories(tensordict).copy(), **kwargs)

    def check_recorded(self, action: Tensor) -> None:
        """Raise ValueError if it reads actions ``[..., A]`` and none were recorded: A is 0."""
        if self.reads_actions and action.shape[-1] == 0:
            raise ValueError(
                "this encoder reads actions, and of these demonstrations none were recorded; a "
                "model with model.encoder_reads=states (by call model={'encoder_reads': 'states'}) "
                "infers from states alone: meta-train one on demonstrations that have actions"
            )

    def _trajectories(self, data: Any) -> Any:
        data = trajectories_of(data)
        if not is_tensor_collection(data):
            return data
        observation = data.get(self.observation_key, None)
        if (action := data.get("action", None)) is not None:
            self.check_recorded(action)
        if observation is not None and data.ndim > observation.ndim - 2:
            raise ValueError(
                f"{type(self).__name__} reduces time: it takes trajectories of batch size [N] with "
                f"observations [N, T, S], got batch size {list(data.shape)} with "
                f"{list(observation.shape)}. Of rollouts [N, T] take rollouts.copy() and set its "
                "batch_size to [N]; a flat batch [N T] has lost its trajectories: do not flatten it"
            )
        return data


class ContextEncoder(GaussianContext):
    """The inference model q_psi(m | tau): an MLP on the whole trajectory, of fixed length.

    Reads ``observation`` ``[N, T, S]`` and ``action`` ``[N, T, A]``; ``get_dist`` gives a diagonal
    Gaussian over ``[N, D]``; calling the module writes ``context_loc``, ``context_scale`` and
    ``context`` (the mean, or a sample under ``ExplorationType.RANDOM``), all ``[N, D]``. A
    :class:`pemirl_trl.DemonstrationDataset` is taken for its trajectories. The widths are those of
    Appendix E.1 of Yu, Yu, Finn and Ermon (2019), "Meta-Inverse Reinforcement Learning with
    Probabilistic Context Variables", arXiv:1909.09314.

    Attributes:
        observation_key, action_key: what it reads.
        loc_key, scale_key, context_key: what it writes.

    Args:
        observation_dim, action_dim, context_dim: S, A and D.
        horizon: T.
        reads_actions: whether it reads actions; one that does not infers from observations alone,
            also where no actions were recorded, and has no ``action_key``.
        hidden: widths of the hidden layers.
        activation: class of the non-linearity.
        standardize: map of observations; by default none.
        scale_depends_on_input: whether the deviation is a function of the trajectory, or one
            vector for all of them (the authors' choice, and the default).
        initial_scale: deviation before training.
        context_key: where the sample is written.

    Raises:
        ValueError: on a call, trajectories of another length.

    Example:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> encoder = ContextEncoder(observation_dim=6, action_dim=2, context_dim=3, horizon=10)
        >>> trajectories = TensorDict(
        ...     {"observation": torch.randn(4, 10, 6), "action": torch.randn(4, 10, 2)}, [4]
        ... )
        >>> posterior = encoder.get_dist(trajectories)
        >>> m = posterior.rsample()
        >>> m.shape, posterior.log_prob(m).shape
        (torch.Size([4, 3]), torch.Size([4]))
    """

    def __init__(
        self,
        observation_dim: int,
        action_dim: int,
        context_dim: int,
        horizon: int,
        *,
        hidden: Sequence[int] = (128, 128),
        activation: type[nn.Module] = nn.ReLU,
        standardize: Standardize | None = None,
        scale_depends_on_input: bool = False,
        initial_scale: float = 1.0,
        context_key: NestedKey = "context",
        reads_actions: bool = True,
    ) -> None:
        head = GaussianHead(context_dim, scale_depends_on_input, initial_scale)
        step = observation_dim + action_dim * reads_actions
        net = RowwiseMLP(horizon * step, head.in_features, hidden, activation)
        flat = _FlatTrajectoryNet(
            net, head, standardize or Standardize.identity(observation_dim), horizon
        )
        super().__init__(flat, context_dim, context_key, reads_actions=reads_actions)
        self.horizon = horizon

    def _trajectories(self, data: Any) -> Any:
        data = super()._trajectories(data)
        mask = data.get("mask", None) if is_tensor_collection(data) else None
        if mask is not None and not bool(mask.all()):
            raise ValueError(
                f"this encoder reads all {self.horizon} steps of a trajectory, and "
                f"{int((~mask.all(-1)).sum())} of these have padding; give the model "
                "encoder='attention', which takes any length, or demonstrations that go on to the "
                "horizon (DemonstrationDataset.with_absorbing_states, if they ended by themselves)"
            )
        return data


class _NothingNet(nn.Module):
    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        nothing = observation.new_empty((*observation.shape[:-2], 0))
        return nothing, nothing


class NoContext(GaussianContext):
    """The inference model of a method without contexts: m has no dimension, log q is 0.

    Reads ``observation`` ``[N, T, S]``; everything that takes a context runs on ``[N, 0]`` as it
    does on ``[N, D]``.

    Args:
        context_key: where the empty context is written.
    """

    def __init__(self, *, context_key: NestedKey = "context") -> None:
        super().__init__(_NothingNet(), 0, context_key, reads_actions=False)


class MaskedContextEncoder(GaussianContext):
    """The inference model q_psi(m | tau) for trajectories of any length, padded to a common one.

    Each step is embedded by an MLP, the embeddings are averaged over the valid steps and a
    second MLP gives the Gaussian. Padding is never read: it may hold anything, NaN included.

    Reads ``observation`` ``[N, T, S]``, ``action`` ``[N, T, A]`` and, where present, ``mask``
    ``[N, T]`` (boolean, True for valid steps); otherwise as :class:`ContextEncoder`.

    Args:
        observation_dim, action_dim, context_dim: S, A and D.
        hidden: widths of the network of a step; the last one is that of the average too.
        activation, standardize, initial_scale: as in :class:`ContextEncoder`.
        scale_depends_on_input, context_key, reads_actions: as there.
        mask_key: where the mask stands.

    Raises:
        ValueError: on a call, a trajectory without a valid step.
    """

    def __init__(
        self,
        observation_dim: int,
        action_dim: int,
        context_dim: int,
        *,
        hidden: Sequence[int] = (128, 128),
        activation: type[nn.Module] = nn.ReLU,
        standardize: Standardize | None = None,
        scale_depends_on_input: bool = False,
        initial_scale: float = 1.0,
        context_key: NestedKey = "context",
        mask_key: NestedKey = "mask",
        reads_actions: bool = True,
    ) -> None:
        head = GaussianHead(context_dim, scale_depends_on_input, initial_scale)
        width = hidden[-1]
        step = observation_dim + action_dim * reads_actions
        step_net = RowwiseMLP(step, width, hidden, activation)
        net = RowwiseMLP(width, head.in_features, [width], activation)
        masked = _MaskedTrajectoryNet(
            step_net, net, head, standardize or Standardize.identity(observation_dim)
        )
        super().__init__(
            masked, context_dim, context_key, mask_key=mask_key, reads_actions=reads_actions
        )
