"""N episodes of a task on a batch of simulations: reset, act, advance, reward, observe."""

from __future__ import annotations

import torch
from torch import Generator, Tensor

from pemirl_envs.simulation import Fields, MujocoBatch, Seed, State, generator_seed
from pemirl_envs.tasks import Parameters, Task


def draw_episode(
    task: Task, n: int, split: str, given: Parameters | None, generator: Generator
) -> tuple[dict[str, Tensor], State]:
    """Draws the parameters and the initial states of ``n`` episodes.

    Parameters are drawn even if they are given (and checked by the caller), so that the states do
    not depend on whether they are.
    """
    parameters = task.sample_parameters(n, split, generator)
    if given is not None:
        parameters = {name: given[name].to(old) for name, old in parameters.items()}
    return parameters, task.initial_state(parameters, generator)


def observe(task: Task, fields: Fields) -> Tensor:
    """What the agent sees, float32 ``[N, S]``.

    Raises:
        ValueError: the task's ``observe`` and its ``observation_components`` disagree on S.
    """
    observation = task.observe(fields)
    if observation.shape[-1] != task.observation_size:
        sizes = {part.name: part.size for part in task.observation_components}
        raise ValueError(
            f"{type(task).__name__}.observe gave {observation.shape[-1]} numbers; its "
            f"observation_components name {task.observation_size}: {sizes}"
        )
    return observation


def check_action(action: Tensor, expected: tuple[int, ...]) -> Tensor:
    """Which rows of an action ``[..., A]`` are finite, bool ``[...]``.

    Raises:
        ValueError: the action does not have the expected shape.
    """
    if action.shape != expected:
        raise ValueError(
            f"expected an action of shape {tuple(expected)}, got {tuple(action.shape)}"
        )
    return torch.isfinite(action).all(-1)


class Episodes:
    """``N`` episodes of one task, each with its own parameters; the engine of the batched faces.

    Args:
        task: the task.
        num_envs: the number of episodes, N.
        split: the set of tasks from which resets draw; ``None``: ``task.default_split``.
        seed: seeds everything that is random; ``None`` takes one from the operating system. See
            :func:`~pemirl_envs.simulation.generator_seed` for what may be one.
        num_threads: threads that step the simulations; see
            :class:`~pemirl_envs.simulation.MujocoBatch`.
        max_steps: ends episodes earlier than the task's horizon does.

    Attributes:
        parameters: the task parameters of each episode. Replaced by resets, never edited.
        step_count: control steps since the reset, int64 ``[N]``. Replaced, never edited.
        generator: the source of all randomness.

    Raises:
        ValueError: unknown split, or a count that is not positive.
    """

    def __init__(
        self,
        task: Task,
        num_envs: int,
        *,
        split: str | None = None,
        seed: Seed = None,
        num_threads: int | None = None,
        max_steps: int | None = None,
    ) -> None:
        split = task.default_split if split is None else split
        if split not in task.splits:
            raise ValueError(f"unknown split {split!r}; expected one of {task.splits}")
        self.task = task
        self.split = split
        self.max_steps = max_steps
        self.simulation = MujocoBatch(task.model, num_envs, num_threads, task.stage)
        self.generator = Generator()
        self.seed(seed)
        self.parameters: dict[str, Tensor] = {}
        self.step_count = torch.zeros(num_envs, dtype=torch.int64)

    def seed(self, seed: Seed) -> None:
        """Restarts the random stream; ``None`` takes a seed from the operating system.

        Raises:
            TypeError, ValueError: it is no seed.
        """
        self.generator.manual_seed(generator_seed(seed))

    def observe(self) -> Tensor:
        """The observations, float32 ``[N, S]``; new memory."""
        return observe(self.task, self.simulation.field)

    def truncated(self) -> Tensor:
        """Which episodes have reached the horizon, or ``max_steps``, bool ``[N]``."""
        horizon = self.task.horizon
        return self.step_count >= (
            horizon if self.max_steps is None else min(horizon, self.max_steps)
        )

    def reset(self, mask: Tensor | None = None, parameters: Parameters | None = None) -> None:
        """Begins new episodes in the simulations of ``mask`` (bool ``[N]``; ``None``: all).

        Draws for all simulations and keeps the draws of the mask: the random stream depends on
        neither the mask nor on what is given.

        Args:
            mask: the simulations to reset.
            parameters: task parameters ``[N, ...]``, of which the rows in ``mask`` are used;
                ``None`` draws them from the split.

        Raises:
            ValueError: illegal parameters, or a first reset that leaves simulations out.
        """
        if mask is not None and mask.all():
            mask = None
        if mask is not None and not self.parameters:
            raise ValueError("the first reset must cover every simulation; got a partial mask")
        n = self.simulation.num_sims
        if parameters is not None:
            self.task.validate_parameters(parameters, n, mask)
        drawn, state = draw_episode(self.task, n, self.split, parameters, self.generator)
        if mask is None:
            self.parameters = drawn
            self.step_count = torch.zeros_like(self.step_count)
        else:
            self.parameters = {
                name: torch.where(mask.view(-1, *[1] * (new.ndim - 1)), new, self.parameters[name])
                for name, new in drawn.items()
            }
            self.step_count = self.step_count.masked_fill(mask, 0)
        models = self.task.models(self.parameters)
        if models is not None:
            self.simulation.set_models(models)
        self.simulation.reset(mask)
        self.simulation.write(state, mask)

    def step(self, action: Tensor, mask: Tensor | None = None) -> tuple[Tensor, dict[int, str]]:
        """Acts once in every episode.

        Args:
            action: ``[N, A]``, clipped to the task's action bounds.
            mask: the simulations to act in, bool ``[N]``; ``None``: all. The others do not move,
                and their rewards are zero.

        Returns:
            The rewards, float32 ``[N]``, and the reasons of the simulations that failed, by index.
            A failed simulation has not moved, and its reward is NaN.

        Raises:
            ValueError: the action does not have the shape [N, A].
            RuntimeError: there has been no reset yet.
        """
        if not self.parameters:
            raise RuntimeError("reset the environment before its first step")
        low, high = self.task.action_bounds
        finite = check_action(action, (self.simulation.num_sims, len(low)))
        acting = finite if mask is None else finite & mask
        healthy, failures = None, {}
        if not acting.all():
            healthy = acting
            broken = ~finite if mask is None else mask & ~finite
            failures = dict.fromkeys(
                broken.nonzero().flatten().tolist(), "the action is not finite"
            )
        control = torch.clamp(action.detach(), low, high)
        reward = self.task.reward(self.simulation.field, control, self.parameters)
        # The step that follows computes what derives from them.
        controls = self.task.control(self.simulation.field, control)
        self.simulation.write(controls, healthy, refresh=False)
        failures |= self.simulation.step(self.task.n_sub_steps, healthy)
        if failures:
            failed = torch.zeros_like(finite)
            failed[list(failures)] = True
            healthy = acting & ~failed
            reward = reward.masked_fill(failed, torch.nan)
        if mask is not None:
            reward = reward.masked_fill(~mask, 0.0)
        disturbed = self.task.disturb(self.simulation.field, self.generator)
        if disturbed:
            self.simulation.write(disturbed, healthy)
        self.step_count = self.step_count + (1 if healthy is None else healthy.long())
        return reward, failures
