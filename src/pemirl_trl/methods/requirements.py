"""What a method asks of an environment, checked before anything is trained."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from tensordict import TensorDictBase
from torchrl.data import Categorical, Composite, TensorSpec
from torchrl.data.tensor_specs import ContinuousBox
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.batched_envs import BatchedEnvBase

from pemirl_trl.data import DemonstrationDataset
from pemirl_trl.modules import CategoricalPolicy
from pemirl_trl.modules.model import Policy
from pemirl_trl.transforms.actions import is_choice


def check_environment(env: EnvBase, policy: Policy, horizon: int) -> None:
    """Compare an environment's specs with what a policy on vectors needs.

    Args:
        env: the environment, with its transforms.
        policy: what is to act in it.
        horizon: T, the length of its episodes.

    Raises:
        ValueError: everything that does not fit, each with its cure.
    """
    problems = [*_batch(env), *_action(env, policy), *_inputs(env, policy), *_length(env, horizon)]
    if problems:
        raise ValueError("this environment cannot be trained on: " + "; ".join(problems))


def check_acted(demonstrations: DemonstrationDataset) -> None:
    """Raise ValueError unless demonstrations have actions, without which nothing can be trained."""
    if demonstrations.action_dim == 0:
        raise ValueError(
            "these demonstrations have no actions: Meta-IL imitates actions, and the discriminator "
            "compares their likelihood, so meta-training needs them. Meta-train on demonstrations "
            "that have them, with model.encoder_reads=states (by call model={'encoder_reads': "
            "'states'}); infer and adapt then take these"
        )


def check_episodes(rollouts: TensorDictBase, horizon: int, *, absorbing: bool = False) -> bool:
    """Look at one episode per environment, of any actions.

    Args:
        rollouts: ``[N, T]``.
        horizon: T.
        absorbing: whether those that end by themselves go on to T.

    Returns:
        Whether the environment ends its episodes at T itself; otherwise it goes on.

    Raises:
        ValueError: an episode ends before T, or not all do at T, or observes NaN or infinity.
    """
    done = rollouts["next", "done"].squeeze(-1)
    last = done[:, -1]
    some = bool(last.any() != last.all()) and not absorbing
    if done[:, :-1].any() or some:
        ends = sorted((done.nonzero()[:, 1] + 1).unique().tolist())
        raise ValueError(
            f"this environment cannot be trained on: with random actions its episodes end at steps "
            f"{ends}, and the demonstrations have {horizon}. "
            + (
                "A time limit is that of the longest demonstration"
                if absorbing
                else "This model knows of no ends but those by time: meta-train one that does "
                "(model.absorbing=true), or switch early termination off (in Gymnasium often "
                "terminate_when_unhealthy=False), and set the time limit to the demonstrations' "
                "length"
            )
        )
    for seen in (rollouts["observation"], rollouts["next", "observation"]):
        if seen.dtype != torch.get_default_dtype():
            raise ValueError(
                f"this environment cannot be trained on: its observations are {seen.dtype}, its "
                f"observation_spec says {torch.get_default_dtype()}; make them what it says, or "
                "say what they are (float64 that is said is cast)"
            )
    observation = rollouts["next", "observation"]
    if not torch.isfinite(observation).all():
        raise ValueError(
            "this environment cannot be trained on: with random actions its observations become "
            "NaN or infinite"
        )
    return bool(last.all())


def _batch(env: EnvBase) -> Iterator[str]:
    if len(env.batch_size) != 1:
        yield (
            f"expected an environment of batch size [N], got {list(env.batch_size)} (make a "
            "batched one, or wrap several in torchrl's SerialEnv or ParallelEnv)"
        )


def _action(env: EnvBase, policy: Policy) -> Iterator[str]:
    spec, size = env.action_spec, policy.action_dim
    choices = is_choice(spec)
    discrete = isinstance(policy, CategoricalPolicy)
    if not (choices or isinstance(spec.space, ContinuousBox)):
        yield (
            f"its actions are {type(spec).__name__} of {spec.dtype}; expected vectors of real "
            "numbers, or one choice of n at a step (several at once: count their combinations)"
        )
    elif choices and not discrete:
        yield (
            f"its actions are {spec.space.n} choices ({type(spec).__name__}); a Gaussian policy "
            "gives real numbers (demonstrations of such actions are one-hot: "
            f"DemonstrationDataset.from_episodes(..., discrete_actions={spec.space.n}))"
        )
    elif discrete and not choices:
        yield (
            "its actions are vectors of real numbers; a categorical policy takes one of "
            f"{size} choices (it was chosen because every demonstrated action is one-hot: "
            'model.actions=continuous, by call model={"actions": "continuous"}, says otherwise)'
        )
    elif discrete and (isinstance(spec, Categorical) or not spec.dtype.is_floating_point):
        yield (
            f"its actions are {type(spec).__name__} of {spec.dtype}; a categorical policy gives "
            "one-hot vectors of real numbers (OneHotActions.of(env) is the transform)"
        )
    elif tuple(spec.shape) != (*env.batch_size, size):
        yield (
            f"its actions have the shape {list(spec.shape)}; the policy's are "
            f"{[*env.batch_size, size]}"
        )


def _inputs(env: EnvBase, policy: Policy) -> Iterator[str]:
    specs: Composite = env.observation_spec
    for key in policy.in_keys:
        spec: TensorSpec | None = specs.get(key, None)
        if spec is None:
            there = sorted(str(k) for k in specs.keys(include_nested=True, leaves_only=True))
            yield (
                f"the policy reads {key!r}, and it gives {there} (RenameTransform renames a key; "
                "observation_keys=[...] makes the observation of some of them)"
            )
        elif spec.dtype != torch.get_default_dtype():
            yield (
                f"{key!r} is {spec.dtype}, and the networks take {torch.get_default_dtype()} "
                "(DoubleToFloat casts)"
            )
    observed = specs.get("observation", None)
    size = policy.standardize.features
    if observed is not None and tuple(observed.shape) != (*env.batch_size, size):
        yield (
            f"its observations have the shape {list(observed.shape)}; the demonstrations' are "
            f"{[*env.batch_size, size]}"
        )


def _length(env: EnvBase, horizon: int) -> Iterator[str]:
    while isinstance(env, TransformedEnv):
        env = env.base_env
    # A SerialEnv that has not begun answers a question for an attribute by asking itself for ever.
    longest = None if isinstance(env, BatchedEnvBase) else getattr(env, "horizon", None)
    if isinstance(longest, int) and longest != horizon:
        yield (
            f"its episodes last {longest} steps, and the model's {horizon}, as the "
            "demonstrations' did"
        )
