"""Ending early leaks no reward: decision problems so small that every episode can be listed."""

import itertools

import pytest
import torch
from tensordict import TensorDict

from pemirl_trl.objectives import FiniteHorizonAdvantage

pytestmark = pytest.mark.usefixtures("float64")

T, STATES, ACTIONS = 4, 5, 2
END = 3  # states from here on end an episode


class Endings:
    """States 0, 1, 2 and two ends, 3 and 4, at random; every sequence of actions, listed.

    Attributes:
        state, action: ``[J, T + 1]`` and ``[J, T]``; an episode stays where it has ended.
        absorbing: ``[J, T]``.
    """

    def __init__(self, seed=0):
        torch.manual_seed(seed)
        successor = torch.randint(STATES, (STATES, ACTIONS))
        successor[0] = torch.tensor([1, END])  # from the start, one action goes on and one ends
        successor[END:] = torch.arange(END, STATES).unsqueeze(-1)
        self.action = torch.tensor([*itertools.product(range(ACTIONS), repeat=T)])
        states = [torch.zeros(len(self.action), dtype=torch.int64)]
        for t in range(T):
            states.append(successor[states[-1], self.action[:, t]])
        self.state = torch.stack(states, 1)
        self.absorbing = self.state[:, :-1] >= END

    def rollouts(self, reward, *, absorbing=True):
        """``[J, T]``, of one context; reward ``[STATES]`` is of a step's start."""
        batch = {
            "observation": torch.nn.functional.one_hot(self.state[:, :-1], STATES).double(),
            "next": {"reward": reward[self.state[:, :-1]].unsqueeze(-1)},
        }
        if absorbing:
            batch["absorbing"] = self.absorbing
        return TensorDict(batch, self.action.shape)

    def advantages(self, rollouts, **options):
        everything = {"gamma": 1.0, "standardize": None, "rollouts_per_context": len(self.action)}
        return FiniteHorizonAdvantage(**everything | options)(rollouts)["advantage"].squeeze(-1)


@pytest.mark.parametrize("level", [1.0, -1.0, 37.5])
@pytest.mark.parametrize(
    "options", [{}, {"gamma": 0.9}, {"lmbda": 0.8}, {"gamma": 0.9, "lmbda": 0.5}]
)
def test_of_a_constant_reward_no_episode_is_better_than_another(level, options):
    problem = Endings()
    assert 0 < problem.absorbing.any(1).double().mean() < 1
    rollouts = problem.rollouts(torch.full((STATES,), level))
    advantage = problem.advantages(rollouts, **options)
    assert advantage.abs().max() < 1e-9 * abs(level)


@pytest.mark.parametrize("level", [1.0, -1.0])
def test_counting_nothing_after_the_end_would_reward_survival_or_ending(level):
    """What the absorbing state is for: masked naively, a constant is a reason to end, or not to."""
    problem = Endings()
    rollouts = problem.rollouts(torch.full((STATES,), level))
    rollouts["next", "reward"][problem.absorbing] = 0.0
    advantage = problem.advantages(rollouts.exclude("absorbing"))
    ends_at_once, goes_on = (problem.action[:, 0] == action for action in (1, 0))
    bias = advantage[ends_at_once, 0].mean() - advantage[goes_on, 0].mean()
    assert bias.sign() == -level
    assert bias.abs() > 0.5


@pytest.mark.parametrize("gamma", [1.0, 0.9])
def test_the_gradient_of_the_steps_before_the_end_is_that_of_the_whole_return(gamma):
    """The surrogate never sees what follows an end, and its gradient is exact all the same.

    Against the derivative of sum_tau p(tau) R(tau), the reward of having ended included.
    """
    problem, reward = Endings(1), torch.randn(STATES)
    logits = torch.randn(STATES, ACTIONS, requires_grad=True)
    state, action = problem.state[:, :-1], problem.action
    log_prob = logits.log_softmax(-1)[state, action]  # [J, T]
    probability = log_prob.sum(1).exp()
    discount = gamma ** torch.arange(T, dtype=torch.float64)
    returns = (discount * reward[state]).sum(1)
    (expected,) = torch.autograd.grad((probability * returns).sum(), logits, retain_graph=True)

    advantage = problem.advantages(problem.rollouts(reward), gamma=gamma)
    weight = probability.detach().unsqueeze(-1) * discount * ~problem.absorbing
    (gradient,) = torch.autograd.grad((weight * advantage * log_prob).sum(), logits)
    assert (gradient[END:] == 0).all()
    torch.testing.assert_close(gradient, expected, atol=1e-12, rtol=1e-9)


def test_absorbing_steps_have_no_advantage_and_count_in_no_statistics():
    problem, reward = Endings(2), torch.randn(STATES)
    acts = ~problem.absorbing
    for group in ("batch", "context"):
        advantage = problem.advantages(problem.rollouts(reward), standardize=group)
        assert (advantage[~acts] == 0).all()
        assert advantage[acts].mean().abs() < 1e-9
        assert advantage[acts].std(correction=0) == pytest.approx(1.0)


def test_an_episode_that_never_ends_is_what_it_was():
    """With a flag that is False everywhere every number stays, to rounding."""
    problem, reward = Endings(3), torch.randn(STATES)
    rollouts = problem.rollouts(reward, absorbing=False)
    for options in ({}, {"standardize": "context", "lmbda": 0.9}):
        without = problem.advantages(rollouts.copy(), **options)
        flag = torch.zeros_like(problem.absorbing)
        flagged = problem.advantages(rollouts.copy().set("absorbing", flag), **options)
        torch.testing.assert_close(flagged, without)
