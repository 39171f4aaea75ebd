"""What is measured of an iteration, and that nothing depends on it."""

import pytest
import torch

from pemirl_trl.methods import Diagnostics
from pemirl_trl.modules.family import FAR


@pytest.fixture
def measured(reach):
    """A model of Reach, its rollouts ``[M K, T]`` of four contexts, and K."""
    model = reach.model()
    env = reach.env(model, contexts=4, rollouts=3)
    torch.manual_seed(0)
    rollouts = env.rollout(reach.horizon, model.policy)
    return model, rollouts, 3


def measure(reach, measured, reward=None):
    model, rollouts, k = measured
    given = rollouts["next", "reward"] if reward is None else reward
    return Diagnostics(model, reach.demonstrations, k)(rollouts, given)


def test_no_random_number_is_drawn_and_no_gradient_left(reach, measured):
    before = torch.get_rng_state()
    first = measure(reach, measured)
    assert torch.equal(torch.get_rng_state(), before)
    assert measure(reach, measured) == first
    assert all(p.grad is None for p in measured[0].parameters())


def test_training_is_the_same_without(reach, state, differences, monkeypatch):
    def after():
        method = reach.pemirl()
        for _ in range(2):
            method.iteration()
        return state(method)

    watched = after()
    monkeypatch.setattr(Diagnostics, "__call__", lambda *_: {})
    assert differences(watched, after()) == []


def test_steps_far_outside_are_counted_and_those_with_a_high_reward(reach, measured, monkeypatch):
    model, rollouts, _ = measured
    demonstrated = reach.demonstrations["observation"]
    far = demonstrated.max() + (FAR + 0.1) * model.standardize.scale
    rollouts["observation"][:, :5] = far  # half of the ten steps
    monkeypatch.setattr(model.reward, "reward", lambda s, m: s.sum(-1, keepdim=True))
    metrics = measure(reach, measured)
    assert metrics["outside/share"] == pytest.approx(0.5)
    assert metrics["outside/rewarded"] == pytest.approx(0.5)  # r grows with the position
    monkeypatch.setattr(model.reward, "reward", lambda s, m: -s.sum(-1, keepdim=True))
    metrics = measure(reach, measured)
    assert (metrics["outside/share"], metrics["outside/rewarded"]) == (pytest.approx(0.5), 0.0)
    rollouts["observation"][:, :5] = far - 0.2 * model.standardize.scale
    assert measure(reach, measured)["outside/share"] == 0.0


def test_a_reward_of_the_context_alone_depends_on_it_and_one_of_the_state_does_not(
    reach, measured, monkeypatch
):
    model = measured[0]
    monkeypatch.setattr(model.reward, "reward", lambda s, m: s.sum(-1, keepdim=True))
    assert measure(reach, measured)["context/in_reward"] == 0.0
    monkeypatch.setattr(model.reward, "reward", lambda s, m: m.sum(-1, keepdim=True))
    # Pairs of different contexts: E (x - y)^2 / 2 over distinct ones of four is 4 / 3 of Var.
    assert measure(reach, measured)["context/in_reward"] == pytest.approx(4 / 3, rel=0.1)


def test_returns_that_only_differ_between_contexts_are_explained(reach, measured):
    rollouts, k = measured[1], measured[2]
    group = torch.arange(len(rollouts)) // k
    reward = group.float().view(-1, 1, 1).expand(*rollouts.shape, 1)
    metrics = measure(reach, measured, reward)
    assert metrics["context/in_return"] == 1.0
    assert metrics["return/learned_deviation"] == 0.0


def test_without_contexts_there_is_nothing_to_say_of_them(reach):
    method = reach.airl(model=reach.model(context_dim=0))
    metrics = method.iteration()
    assert not any(name.startswith("context/") for name in metrics)
    assert {"outside/share", "outside/rewarded"} <= metrics.keys()


def test_meta_infogail_is_measured_as_well(reach):
    metrics = reach.meta_infogail().iteration()
    assert {"context/in_reward", "context/information", "outside/rewarded"} <= metrics.keys()
