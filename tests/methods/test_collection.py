"""Whole episodes, each from a fresh reset, under the policy of the moment."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import TransformedEnv

from pemirl_trl import InferContext
from pemirl_trl.methods import EpisodeCollector


def collector(problem, horizon=None, contexts=2):
    model = problem.model()
    env = problem.env(model, contexts, 2)
    return model, EpisodeCollector(env, model.policy, horizon or problem.horizon)


def test_every_call_gives_whole_episodes_from_a_reset(reach):
    _, collect = collector(reach)
    first, second = collect(), collect()
    assert collect.frames == 4 * 10
    for rollouts in (first, second):
        assert rollouts.shape == (4, 10)
        done = rollouts["next", "done"].squeeze(-1)
        assert done[:, -1].all()
        assert not done[:, :-1].any()
        torch.testing.assert_close(
            rollouts["observation"][:, 1:], rollouts["next", "observation"][:, :-1]
        )
        assert rollouts["observation"][:, 0].abs().max() < 1.0  # N(0, 0.1)
    assert not torch.equal(first["context"], second["context"])


@pytest.mark.parametrize(("horizon", "ends"), [(7, r"\[\]"), (12, r"\[10\]")])
def test_another_horizon_than_the_environments_is_refused(horizon, ends, reach, monkeypatch):
    """Also where the environment does not tell its own as a whole number."""
    monkeypatch.setattr(type(reach.make(1)), "horizon", 10.0)
    _, collect = collector(reach, horizon)
    with pytest.raises(ValueError, match=rf"end at step {horizon}, got ends at steps {ends}"):
        collect()


def test_an_environment_without_a_batch_is_refused(reach):
    model = reach.model()
    env = reach.make(2)
    env.batch_size = []
    with pytest.raises(ValueError, match=r"batch size \[N\], got \[\]"):
        EpisodeCollector(env, model.policy, 10)


def test_a_step_of_the_policy_counts_at_once(reach):
    model, collect = collector(reach)
    before = collect()
    with torch.no_grad():
        model.policy.log_scale.fill_(-9.0)
    assert (before["scale"] == 1.0).all()
    torch.testing.assert_close(collect()["scale"], torch.full((4, 10, 1), -9.0).exp())


def test_the_state_replays_the_environments_own_randomness(maze):
    _, collect = collector(maze)
    collect()
    state = TensorDict(collect.state_dict()).clone()
    start, other, again = [], [], []
    for seen, restore in ((start, False), (other, False), (again, True)):
        if restore:
            collect.load_state_dict(state)
        seen.append(collect()["observation"][:, 0])
    assert torch.equal(start[0], again[0])
    assert not torch.equal(start[0], other[0])


def test_without_ground_truth_there_is_no_true_return(reach):
    """The environment then draws some task of its own, and its return means nothing."""
    model = reach.model()
    for tasks in (reach.tasks, None):
        transform = InferContext(
            model.encoder, reach.demonstrations, rollouts_per_context=2, tasks=tasks
        )
        env = TransformedEnv(reach.make(4), transform)
        collect = EpisodeCollector(env, model.policy, reach.horizon)
        told = collect.true_return(collect())
        assert set(told) == ({"return/true"} if tasks is not None else set())


def test_an_environment_that_breaks_down_is_named_and_not_the_training(reach, monkeypatch):
    _, collect = collector(reach)
    collect()
    monkeypatch.setattr(type(reach.make(1)), "step_size", float("inf"))
    with pytest.raises(ValueError, match="the environment observed NaN or infinity, after 40 step"):
        collect()
