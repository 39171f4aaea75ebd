"""Expert and policy transitions in equal number, for the discriminator."""

from __future__ import annotations

from typing import Literal

import torch
from pydantic.dataclasses import dataclass
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from pemirl_trl.configuration import CHECKED, Count, NonNegative, Share
from pemirl_trl.data import Negatives
from pemirl_trl.data.negatives import gather_steps
from pemirl_trl.modules import PEMIRLModel
from pemirl_trl.modules.reading import shown_of

NegativeLogProb = Literal["collection", "current"]
FIELDS = ("observation", ("next", "observation"), "action", "context")


@dataclass(frozen=True, config=CHECKED)
class BatchConfig:
    """Of one discriminator batch.

    Attributes:
        trajectories: how many of the expert, and how many of the policy.
        time_steps: transitions drawn from each trajectory.
        current_fraction: share of the policy's trajectories that comes from the last iteration;
            the rest is uniform over the iterations that are replayed.
        negative_log_prob: the log pi of the policy's transitions: that of their ``"collection"``,
            or that of the ``"current"`` policy; see :class:`pemirl_trl.AIRLDiscriminator`.
        jitter_fraction: share of the policy's trajectories that gets Gaussian noise on its
            observations, the same on s and s'. Blurred negatives enclose the expert's support.
            An extension of the paper; 0 is off.
        jitter_scale: the noise's deviation is drawn per trajectory from U(0, jitter_scale), in
            units of the demonstrations' deviation, feature by feature.
        mismatched_fraction: share of the negatives that are the expert's, not the policy's, under
            the context of another demonstration: an expert, but of which task? Against them alone
            the logit's optimum is log p(s, a|m) - log p(s, a), the pointwise mutual information
            of transition and context: what all tasks have in common, a posture say, earns
            nothing. An extension of the paper; 0 is off.
        relative_log_prob: whether log pi is taken relative to the current policy's density at its
            mean. A constant in each batch, which r's own constant would take up. But where the
            deviation is annealed the constant grows, by log(1 / 0.3) per action component say, and
            a network that chases it tilts where no data hold it. An extension of the paper.
    """

    trajectories: Count = 200
    time_steps: Count = 10
    current_fraction: Share = 0.5
    negative_log_prob: NegativeLogProb = "collection"
    jitter_fraction: Share = 0.0
    jitter_scale: NonNegative = 0.0
    mismatched_fraction: Share = 0.0
    relative_log_prob: bool = False


class DiscriminatorBatches:
    """Draws batches ``[2 n k]`` of n trajectories a side and k transitions each.

    An expert transition's m is drawn from q(m | its own demonstration), by reparameterisation, and
    its log pi is the current policy's. A policy transition keeps the m that produced it and, unless
    told otherwise, the log pi of its collection. Mismatched negatives, where they are asked for,
    stand last.

    Args:
        model: gives m and log pi.
        demonstrations: batch size ``[J]``, leaves ``[J, T, ...]``.
        negatives: the policy's rollouts.
        config: of a batch.
        encoder_gradient: whether the expert's m carries gradients to the encoder.

    Raises:
        ValueError: mismatched negatives for a model without contexts.
    """

    def __init__(
        self,
        model: PEMIRLModel,
        demonstrations: TensorDictBase,
        negatives: Negatives,
        config: BatchConfig,
        *,
        encoder_gradient: bool = True,
    ) -> None:
        if config.mismatched_fraction > 0 and model.config.context_dim == 0:
            raise ValueError(
                f"mismatched_fraction is {config.mismatched_fraction}, but the model has no "
                "contexts to confuse; expected 0"
            )
        self.model, self.demonstrations, self.negatives = model, demonstrations, negatives
        self.config = config
        self.encoder_gradient = encoder_gradient

    def sample(self, last: int) -> TensorDict:
        """One batch, with ``is_expert``; negatives come from the ``last`` iterations."""
        c = self.config
        mismatched = round(c.mismatched_fraction * c.trajectories)
        parts = [self._expert()]
        if mismatched < c.trajectories:
            parts.append(self._policy(last, c.trajectories - mismatched))
        if mismatched > 0:
            parts.append(self._mismatched(parts[0], mismatched))
        batch = TensorDict.cat(parts).reshape(-1)
        if c.relative_log_prob:
            relative = batch["action_log_prob"] - self.model.policy.log_peak.detach()
            batch.set("action_log_prob", relative)
        return batch

    def _expert(self) -> TensorDict:
        c = self.config
        index = torch.randint(self.demonstrations.batch_size[0], (c.trajectories,))
        encoder = self.model.encoder
        drawn = shown_of(self.demonstrations).select(*encoder.in_keys, strict=False)[index]
        with torch.set_grad_enabled(self.encoder_gradient):
            m = encoder.get_dist(drawn).rsample()  # [n, D]
        horizon = self.demonstrations["action"].shape[1]
        times = torch.randint(horizon, (c.trajectories, c.time_steps))
        if "mask" in self.demonstrations:
            times = _within(self.demonstrations["mask"][index].sum(1), times.shape)
        batch = gather_steps(self.demonstrations.select(*FIELDS[:-1]), index, times)
        batch.set("context", m.unsqueeze(1).expand(*times.shape, -1))
        batch.set("action_log_prob", self._log_prob(batch))
        return batch.set("is_expert", _flag(times, True))

    @torch.no_grad()
    def _log_prob(self, batch: TensorDictBase) -> Tensor:
        inputs = batch.select(*self.model.policy.in_keys)
        policy = self.model.policy.get_dist(inputs)
        log_prob = policy.log_prob(batch["action"])
        if not self.model.config.absorbing:
            return log_prob
        # After an end no action was taken. Both sides get what the policy's own would have on
        # average: then what an end is worth does not depend on the units of actions, as densities
        # do, nor on how precise the policy is.
        return torch.where(batch["observation"][..., -1] > 0.5, -policy.entropy(), log_prob)

    def _policy(self, last: int, trajectories: int) -> TensorDict:
        c = self.config
        current = round(c.current_fraction * trajectories)
        parts = [
            self.negatives.sample(
                count, steps=c.time_steps, last=reach, lengths=self._lengths(count)
            )
            for count, reach in ((current, 1), (trajectories - current, last))
            if count > 0
        ]
        batch = TensorDict.cat(parts).select(*FIELDS, "action_log_prob")
        if c.negative_log_prob == "current":
            batch.set("action_log_prob", self._log_prob(batch))
        if c.jitter_fraction > 0:
            self._jitter(batch)
        return batch.set("is_expert", _flag(batch["action_log_prob"], False))

    def _lengths(self, count: int) -> Tensor | None:
        """Lengths at which the policy's trajectories are cut, since demonstrations are: ``[n]``.

        What comes after a cut nobody knows; without this, late states would be the policy's alone.
        """
        mask = self.demonstrations.get("mask", None)
        return None if mask is None else mask.sum(1)[torch.randint(len(mask), (count,))]

    def _mismatched(self, expert: TensorDict, trajectories: int) -> TensorDict:
        """The expert's transitions, each trajectory under the context of another one.

        Their log pi stays that of their own context, as a policy transition's is that of the policy
        which drew it: under the other task the action would have next to no density, and its
        logarithm would rule the loss.
        """
        batch = expert[:trajectories].clone()
        other = torch.randperm(len(expert))[:trajectories]
        batch.set("context", expert["context"][other].detach())
        return batch.set("is_expert", _flag(batch["action_log_prob"], False))

    def _jitter(self, batch: TensorDict) -> None:
        c, shape = self.config, batch["observation"].shape
        scale = torch.rand(shape[0], 1, 1) * c.jitter_scale * self.model.standardize.scale
        chosen = (torch.rand(shape[0], 1, 1) < c.jitter_fraction).to(scale.dtype)
        noise = chosen * scale * torch.randn(shape)
        if self.model.config.absorbing:
            noise[..., -1] = 0.0  # an episode has ended, or it has not
        for key in FIELDS[:2]:
            batch.set(key, batch.get(key) + noise)


def _within(lengths: Tensor, shape: tuple[int, ...]) -> Tensor:
    """Times ``[n, k]``, uniform over the first ``lengths`` ``[n]`` steps."""
    return (torch.rand(shape) * lengths.unsqueeze(-1)).long()


def _flag(like: Tensor, value: bool) -> Tensor:
    return torch.full(like.shape, value, dtype=torch.bool)
