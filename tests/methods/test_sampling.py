"""What collectors call in the place of a Gaussian policy."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from pemirl_trl.methods.sampling import GaussianSampler, sampler_of
from pemirl_trl.modules import ContextPolicy
from pemirl_trl.modules.reading import MissingKeyError


class OwnPolicy(ContextPolicy):
    """A policy that may do what it likes."""


@pytest.mark.parametrize("actions", [1, 2, 8])
@pytest.mark.parametrize("kind", [ExplorationType.RANDOM, ExplorationType.DETERMINISTIC])
def test_it_writes_the_bits_that_the_policy_writes(kind, actions):
    policy = ContextPolicy(2, actions, 3, context_key=("task", "goal"), log_prob_key="log_pi")
    sampler = sampler_of(policy)
    assert isinstance(sampler, GaussianSampler)
    goals = TensorDict({"goal": torch.randn(50, 7, 3)}, [50, 7])
    batch = TensorDict({"observation": torch.randn(50, 7, 2), "task": goals}, [50, 7])
    outputs = []
    for acting in (policy, sampler):
        torch.manual_seed(1)
        with torch.no_grad(), set_exploration_type(kind):  # step by step, as a collector does
            outputs.append(torch.stack([acting(batch[:, t].copy()) for t in range(7)], 1))
    expected, ours = outputs
    sampler.complete(ours)
    assert set(ours.keys(True)) == set(expected.keys(True))
    assert all(torch.equal(ours[key], expected[key]) for key in expected.keys(True, True))


def test_another_kind_of_policy_acts_for_itself():
    policy = OwnPolicy(2, 2, 3)
    assert sampler_of(policy) is policy


def test_a_batch_without_contexts_is_an_error_that_says_so():
    sampler = sampler_of(ContextPolicy(2, 2, 3))
    batch = TensorDict({"observation": torch.randn(5, 2)}, [5])
    random = set_exploration_type(ExplorationType.RANDOM)
    with random, pytest.raises(MissingKeyError, match="ContextPolicy reads 'context'"):
        sampler(batch)
