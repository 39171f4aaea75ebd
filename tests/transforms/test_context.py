"""The context of a rollout: drawn once at reset from q(m | demonstration), shared by its group."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.collectors import Collector
from torchrl.envs import Compose, RewardSum, TransformedEnv
from torchrl.envs.utils import check_env_specs

from pemirl_trl.data import DemonstrationDataset
from pemirl_trl.modules import ContextEncoder, ContextPolicy, NoContext, PEMIRLModel
from pemirl_trl.transforms import InferContext

from .toy import Line

J, M, K, T, D = 6, 4, 3, 3, 2
N = M * K


@pytest.fixture
def demonstrations():
    return TensorDict({"observation": torch.randn(J, T, 2), "action": torch.randn(J, T, 1)}, [J])


@pytest.fixture
def tasks():
    return TensorDict({"goal": torch.arange(1.0, J + 1).unsqueeze(-1)}, [J])


@pytest.fixture
def encoder():
    return ContextEncoder(2, 1, D, T)


@pytest.fixture
def make(demonstrations, encoder):
    def make_env(num_envs=N, **kwargs):
        settings = {"rollouts_per_context": K, "sample": False} | kwargs
        return TransformedEnv(Line(num_envs, T), InferContext(encoder, demonstrations, **settings))

    return make_env


def grouped(values):
    return values.view(-1, K, *values.shape[1:])


@pytest.mark.parametrize("context_key", ["context", ("latent", "m")])
def test_specs_hold(make, tasks, context_key):
    check_env_specs(make(context_key=context_key, tasks=tasks))


def test_the_context_is_that_of_the_demonstration_drawn(make, encoder, demonstrations):
    start = make().reset()
    index = start["demonstration"]
    assert torch.allclose(start["context"], encoder.get_dist(demonstrations[index]).mean)
    assert start["context"].shape == (N, D)
    assert not start["context"].requires_grad


def test_the_context_is_that_of_what_is_shown_in_its_place(make, encoder, demonstrations):
    shown = demonstrations.clone().apply(torch.neg)
    demonstrations.set("shown", shown)
    start = make().reset()
    assert torch.allclose(start["context"], encoder.get_dist(shown[start["demonstration"]]).mean)


def test_without_contexts_demonstrations_are_drawn_all_the_same(demonstrations, tasks):
    transform = InferContext(NoContext(), demonstrations, rollouts_per_context=K, tasks=tasks)
    env = TransformedEnv(Line(N, T), transform)
    check_env_specs(env)
    start = env.reset()
    assert start["context"].shape == (N, 0)
    assert torch.equal(start["task", "goal"], tasks["goal"][start["demonstration"]])
    rollouts = env.rollout(T, ContextPolicy(2, 1, 0))
    assert rollouts["context"].shape == (N, T, 0)


def test_the_rollouts_of_a_group_share_one_draw(make):
    start = make(sample=True).reset()
    for key in ("context", "demonstration"):
        groups = grouped(start[key])
        assert torch.equal(groups, groups[:, :1].expand_as(groups))
    assert len(start["context"].unique(dim=0)) == M  # also where a demonstration comes twice


def test_a_sample_is_from_the_posterior_whatever_the_exploration_type(
    make, encoder, demonstrations
):
    env = make(sample=True)
    draws = []
    for _ in range(200):
        start = env.reset()
        q = encoder.get_dist(demonstrations[start["demonstration"]])
        draws.append(((start["context"] - q.mean) / q.stddev)[::K])
    standard = torch.stack(draws)
    assert standard.mean().abs() < 0.1
    assert abs(standard.std() - 1) < 0.1


def test_the_context_is_held_through_an_episode_and_drawn_anew_after_it(make):
    batch = make(sample=True).rollout(3 * T, break_when_any_done=False)  # three episodes
    episodes = batch["context"].view(N, 3, T, D)
    assert torch.equal(episodes, episodes[:, :, :1].expand_as(episodes))
    assert (episodes[:, 1:, 0] != episodes[:, :-1, 0]).all()
    assert torch.equal(batch["next", "context"], batch["context"])
    assert torch.equal(batch["next", "demonstration"], batch["demonstration"])


def test_every_demonstration_is_drawn_alike(make):
    env = make()
    drawn = torch.stack([env.reset()["demonstration"][::K] for _ in range(300)]).flatten()
    count = drawn.bincount(minlength=J).double()
    expected = len(drawn) / J
    chi_square = ((count - expected).square() / expected).sum()
    assert chi_square < 20.5  # 0.1 % of J - 1 = 5 degrees of freedom


def test_all_demonstrations_in_order(make, encoder, demonstrations):
    start = make(J * K, draw="all").reset()
    assert torch.equal(start["demonstration"], torch.arange(J).repeat_interleave(K))
    expected = encoder.get_dist(demonstrations).mean.repeat_interleave(K, 0)
    assert torch.allclose(start["context"], expected)


def test_the_drawn_tasks_reach_the_environment(make, tasks):
    batch = make(tasks=tasks).rollout(2 * T, break_when_any_done=False)
    goal = tasks["goal"][batch["demonstration"]]
    assert len(goal.unique()) > 1
    assert torch.equal(batch["task", "goal"], goal)
    expected = -(batch["next", "observation"][..., :1] - goal).square()
    assert torch.equal(batch["next", "reward"], expected)


def test_without_tasks_the_environments_own_stays(make):
    env = make()
    env.base_env.goal = torch.full((N, 1), 9.0)
    assert (env.rollout(T)["task", "goal"] == 9.0).all()


def test_a_masked_reset_draws_for_whole_groups_only(make, tasks):
    env = make(sample=True, tasks=tasks)
    before = env.rollout(1)[:, -1]["next"]
    mask = torch.zeros(N, 1, dtype=torch.bool)
    mask[K : 2 * K] = True
    after = env.reset(before.clone().set("_reset", mask))
    changed = (after["context"] != before["context"]).any(-1)
    assert torch.equal(changed, mask.squeeze(-1))
    assert torch.equal(after["demonstration"][~changed], before["demonstration"][~changed])
    assert torch.equal(after["task", "goal"], tasks["goal"][after["demonstration"]])
    step = env.step(env.rand_action(after))["next"]
    assert torch.equal(step["context"], after["context"])


def test_a_masked_reset_of_part_of_a_group_is_refused(make):
    env = make()
    before = env.reset()
    mask = torch.zeros(N, 1, dtype=torch.bool)
    mask[K] = True
    with pytest.raises(ValueError, match="all 3 rollouts of a context or none"):
        env.reset(before.set("_reset", mask))


def test_a_reset_uses_the_encoders_weights_of_that_moment(make, encoder, demonstrations):
    env = make(J * K, draw="all")
    before = env.reset()["context"]
    with torch.no_grad():
        for parameter in encoder.parameters():
            parameter.add_(0.1)
    after = env.reset()["context"]
    assert not torch.allclose(after, before)
    assert torch.allclose(after[::K], encoder.get_dist(demonstrations).mean)


def test_a_collector_carries_the_context(make, encoder, demonstrations):
    env = make(sample=True).append_transform(RewardSum())
    collector = Collector(
        env,
        ContextPolicy(2, 1, D),
        frames_per_batch=N * T,
        total_frames=2 * N * T,
        reset_at_each_iter=True,
        auto_register_policy_transforms=False,
    )
    batches = [batch.clone() for batch in collector]
    for batch in batches:
        assert batch.shape == (N, T)
        context = batch["context"]
        assert torch.equal(context, context[:, :1].expand_as(context))
        assert len(context[:, 0].unique(dim=0)) == M
    assert (batches[0]["context"] != batches[1]["context"]).all()


def test_the_global_seed_fixes_the_draws(make):
    def draws(seed):
        torch.manual_seed(seed)
        return make(sample=True).reset()["context"]

    assert torch.equal(draws(3), draws(3))
    assert not torch.equal(draws(3), draws(4))


def test_the_demonstrations_are_not_state(make):
    assert not [key for key in make().state_dict() if "demonstrations" in key]


def test_senseless_settings_are_refused(make, encoder, demonstrations, tasks):
    with pytest.raises(ValueError, match=r"'first'; choose one of \('random', 'all'\)"):
        InferContext(encoder, demonstrations, draw="first")
    with pytest.raises(ValueError, match="got 6 demonstrations and 4 tasks"):
        InferContext(encoder, demonstrations, tasks=tasks[:4])
    with pytest.raises(ValueError, match="10 environments do not hold 3 rollouts of each context"):
        make(10).reset()
    with pytest.raises(ValueError, match="12 environments do not hold 3 rollouts of each of 6"):
        make(12, draw="all").reset()


def test_it_composes(make, encoder, demonstrations, tasks):
    infer = InferContext(encoder, demonstrations, rollouts_per_context=K, tasks=tasks)
    check_env_specs(TransformedEnv(Line(N, T), Compose(RewardSum(), infer)))


def test_a_data_set_is_taken_for_its_trajectories(encoder):
    dataset = DemonstrationDataset(torch.randn(J, T + 1, 2), torch.randn(J, T, 1))
    transform = InferContext(encoder, dataset, draw="all", sample=False)
    start = TransformedEnv(Line(J, T), transform).reset()
    assert torch.allclose(start["context"], encoder.get_dist(dataset.trajectories()).mean)


def test_another_network_than_an_encoder_is_refused(demonstrations):
    with pytest.raises(TypeError, match=r"InferContext takes an encoder .*got ContextPolicy"):
        InferContext(ContextPolicy(2, 1, D), demonstrations)


def test_a_model_is_pointed_to_its_encoder(demonstrations):
    with pytest.raises(TypeError, match=r"got PEMIRLModel: pass its \.encoder"):
        InferContext(PEMIRLModel(2, 1, T), demonstrations)


def test_a_step_from_a_state_without_context_says_who_writes_it(make):
    env = make()
    start = env.reset().exclude("context").set("action", torch.zeros(N, 1))
    with pytest.raises(KeyError, match=r"reads 'context'.*InferContext writes it at reset"):
        env.step(start)


def test_the_spec_has_the_encoders_precision(demonstrations, float64):
    env = TransformedEnv(
        Line(J, T), InferContext(ContextEncoder(2, 1, D, T), demonstrations, draw="all")
    )
    assert env.observation_spec["context"].dtype == torch.float64
    check_env_specs(env)


class Deaf(Line):
    """Keeps the task that it has, whatever it is told at reset."""

    def _reset(self, tensordict=None, **kwargs):
        told = None if tensordict is None else tensordict.exclude("task")
        return super()._reset(told, **kwargs)


class Mute(Line):
    """Never says what its task is."""

    def __init__(self, *sizes):
        super().__init__(*sizes)
        del self.observation_spec["task"]

    def _state(self, truncated):
        return super()._state(truncated).exclude("task")


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (Deaf, "did not take the tasks that it was reset to: its .*'task', 'goal'.* is another"),
        (Mute, "the environment's reset writes no 'task': it may not have read them"),
    ],
)
def test_an_environment_that_ignores_its_tasks_is_refused(
    encoder, demonstrations, tasks, kind, message
):
    """Its reward would be reported as the true one of tasks that it has never heard of."""
    told = InferContext(encoder, demonstrations, rollouts_per_context=K, tasks=tasks)
    with pytest.raises(ValueError, match=message):
        TransformedEnv(kind(N, T), told).reset()
    untold = InferContext(encoder, demonstrations, rollouts_per_context=K)
    assert "context" in TransformedEnv(kind(N, T), untold).reset()
