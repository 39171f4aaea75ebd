"""Environments that end early, continued to their horizon in absorbing states."""

from __future__ import annotations

import torch
from tensordict import TensorDictBase
from tensordict.utils import NestedKey
from torch import Tensor
from torchrl.data import Categorical, Composite, Unbounded
from torchrl.envs import Transform


class AbsorbingState(Transform):
    """Let an episode that ends by itself go on to T, where it ended.

    The observation gets one component more, an indicator. Once the environment says ``terminated``,
    the observation stays that of the end with an indicator of 1, whatever the actions; the true
    reward is 0; and the episode is over at T alone, as all are (:class:`torchrl.envs.StepCounter`).
    So the learned reward of having ended, r((s_end, 1), m), is learned like any other and is
    collected at every step that is left: no reward leaks through the length of an episode. With a
    reward of c everywhere, ending early is worth neither more nor less than going on; if what comes
    after an end counted as 0 instead, every c > 0 would be a bonus for survival, and every c < 0
    one for ending, whatever was demonstrated.

    ``truncated`` says that somebody stopped looking, not that anything ended: it passes, up to an
    end. Writes ``absorbing`` ``[N]``, True where a step begins in an absorbing state: its action
    decides nothing, and no policy is trained by it.

    That an absorbing state has a learned reward is from Kostrikov, Agrawal, Dwibedi, Levine and
    Tompson (2019), "Discriminator-Actor-Critic: Addressing Sample Inefficiency and Reward Bias in
    Adversarial Imitation Learning", arXiv:1809.02925. Theirs is one state for all ends; here it
    remembers where the end was, since r(s, m) is of states, and a fall is no goal.

    The environment keeps being stepped after an end, and what it then says is not used: it is never
    reset before T, and it may not raise.

    Args:
        observation_key: where the observation is, ``[N, S]``.
        absorbing_key: where the flag is written.

    Example:
        >>> import warnings
        >>> from torchrl.envs import Compose, GymEnv, StepCounter, TransformedEnv
        >>> counted = Compose(AbsorbingState(), StepCounter(300))
        >>> env = TransformedEnv(GymEnv("CartPole-v1"), counted)
        >>> with warnings.catch_warnings(action="ignore"):  # Gymnasium's, of steps after an end
        ...     rollout = env.rollout(300)  # a pole that nobody balances falls after some 20 steps
        >>> rollout.shape, bool(rollout["absorbing"][-1])
        (torch.Size([300]), True)
    """

    def __init__(
        self, observation_key: NestedKey = "observation", absorbing_key: NestedKey = "absorbing"
    ) -> None:
        super().__init__(in_keys=[observation_key], out_keys=[observation_key])
        self.observation_key, self.absorbing_key = observation_key, absorbing_key

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        observation = tensordict_reset.get(self.observation_key)
        absorbing = torch.zeros_like(observation[..., 0], dtype=torch.bool)
        return self._write(tensordict_reset, observation, absorbing)

    def _step(self, tensordict: TensorDictBase, next_tensordict: TensorDictBase) -> TensorDictBase:
        before = tensordict.get(self.absorbing_key)
        shown = before.unsqueeze(-1)
        terminated = next_tensordict.get("terminated") & ~shown
        observation = torch.where(
            shown,
            tensordict.get(self.observation_key),  # without the indicator: see _inv_call
            next_tensordict.get(self.observation_key),
        )
        done = torch.zeros_like(terminated)
        if (truncated := next_tensordict.get("truncated", None)) is not None:
            done = truncated & ~shown & ~terminated
            next_tensordict.set("truncated", done.clone())
        next_tensordict.set("terminated", torch.zeros_like(terminated)).set("done", done)
        reward = next_tensordict.get("reward")
        next_tensordict.set("reward", reward.masked_fill(shown, 0.0))
        return self._write(next_tensordict, observation, before | terminated.squeeze(-1))

    def _write(
        self, tensordict: TensorDictBase, observation: Tensor, absorbing: Tensor
    ) -> TensorDictBase:
        indicator = absorbing.unsqueeze(-1).to(observation.dtype)
        tensordict.set(self.observation_key, torch.cat([observation, indicator], -1))
        return tensordict.set(self.absorbing_key, absorbing)

    def _inv_call(self, tensordict: TensorDictBase) -> TensorDictBase:
        """The environment is shown its own observation, should it read it back."""
        observation = tensordict.get(self.observation_key, None)
        if observation is not None:
            tensordict.set(self.observation_key, observation[..., :-1])
        return tensordict

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        """Add the indicator and the flag."""
        seen = observation_spec[self.observation_key]
        shape, device = (*seen.shape[:-1], seen.shape[-1] + 1), seen.device
        wider = Unbounded(shape, device=device, dtype=seen.dtype)
        observation_spec[self.observation_key] = wider
        flag = Categorical(2, seen.shape[:-1], device=device, dtype=torch.bool)
        observation_spec[self.absorbing_key] = flag
        return observation_spec
