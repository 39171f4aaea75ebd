"""Methods where episodes end by themselves: the same data on both sides, and nothing leaks."""

import math

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from tensordict import TensorDict
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import Compose, EnvBase, StepCounter, TransformedEnv

from pemirl_trl import (
    AbsorbingState,
    DemonstrationDataset,
    InferContext,
    ModelConfig,
    adapt,
    infer,
    load_model,
    meta_train,
    save_model,
)
from pemirl_trl.data import Negatives
from pemirl_trl.methods import (
    TRPO,
    BatchConfig,
    DiscriminatorBatches,
    EpisodeCollector,
    MethodConfig,
    TRPOConfig,
    meta_training_config,
    new_model,
)
from pemirl_trl.methods.environments import ends_early

T = 8
FEW = {
    "meta_il": {"steps": 4, "steps_per_iteration": 2},
    "contexts_per_batch": 4,
    "training": {
        "iterations": 2,
        "rollouts_per_context": 2,
        "batch": {"trajectories": 8},
    },
}


class Door(EnvBase):
    """A point on a line; beyond 1 or -1 it has left, and the episode ends. No time limit."""

    def __init__(self, num_envs, at=1.0):
        super().__init__(batch_size=[num_envs])
        one = (num_envs, 1)
        self.at = at
        self.observation_spec = Composite(observation=Unbounded(one), shape=[num_envs])
        self.action_spec = self.reward_spec = Unbounded(one)
        flags = {key: Binary(1, one, dtype=torch.bool) for key in ("done", "terminated")}
        self.full_done_spec = Composite(flags, shape=[num_envs])

    def _set_seed(self, seed):
        """Nothing is random."""

    def _reset(self, tensordict=None, **kwargs):
        self.position = torch.zeros(*self.batch_size, 1)
        return TensorDict({"observation": self.position.clone()}, self.batch_size)

    def _step(self, tensordict):
        self.position = self.position + 0.3 * tensordict["action"]
        left = self.position.abs() > self.at
        flags = {"done": left, "terminated": left.clone()}
        reward = torch.ones_like(self.position)
        return TensorDict(
            {"observation": self.position.clone(), "reward": reward, **flags}, self.batch_size
        )


def demonstrations(terminated=True, count=12, horizon=T, longest=T):
    """Walks to either door at several speeds, with noise; the slow ones do not arrive."""
    torch.manual_seed(0)
    pairs = []
    for i in range(count):
        speed = (-1) ** i * (0.3 + 1.5 * i / count)
        action = speed + 0.1 * torch.randn(longest, 1)
        at = torch.cat([torch.zeros(1, 1), 0.3 * action.cumsum(0)])
        left = (at.abs() > 1).flatten()
        n = int(left.int().argmax()) if left.any() else longest
        pairs.append((at[: n + 1], action[:n]))
    flags = None if terminated is None else terminated
    return DemonstrationDataset.from_episodes(pairs, terminated=flags, horizon=horizon)


def make(num_envs, seed):
    return Door(num_envs)


@pytest.fixture(scope="module")
def model():
    return meta_train(make, demonstrations(), **FEW)


def collector(model, num_envs=8):
    data = demonstrations().with_absorbing_states()
    context = InferContext(model.encoder, data, rollouts_per_context=2)
    env = TransformedEnv(Door(num_envs), Compose(AbsorbingState(), StepCounter(T), context))
    return EpisodeCollector(env, model.policy, T)


@pytest.fixture
def rollouts(model):
    torch.manual_seed(1)
    batch = collector(model)()
    assert 0 < batch["absorbing"].float().mean() < 1
    return batch


# --- from demonstrations to a policy -----------------------------------------------------------


def test_one_call_takes_episodes_of_several_lengths(model, tmp_path):
    assert model.config.absorbing
    assert (model.observation_dim, model.horizon) == (2, T)
    save_model(tmp_path / "model.safetensors", model)
    loaded = load_model(tmp_path / "model.safetensors")
    assert loaded.config.absorbing
    new = demonstrations()[[0, 5]]
    optimization = {"iterations": 2}
    adaptation = adapt(
        loaded, new, lambda n, seed: Door(n, 0.5), rollouts=4, optimization=optimization
    )
    assert adaptation.learned_return >= adaptation.carried_over_return


def test_a_demonstration_shorter_than_any_is_read_as_it_is(model):
    pair = (torch.tensor([[0.0], [0.6], [1.2]]), torch.full((2, 1), 2.0))
    alone = infer(model, DemonstrationDataset.from_episodes([pair]))
    among = infer(model, DemonstrationDataset.from_episodes([pair], horizon=T))
    assert torch.equal(alone.context, among.context)
    # With and without the indicator: a state, and having ended there.
    state = torch.tensor([[0.5], [1.2]])
    expected = alone.reward(torch.tensor([[0.5, 0.0], [1.2, 0.0]]))
    assert torch.equal(alone.reward(state), expected)
    assert not torch.equal(alone.reward(torch.tensor([[0.5, 1.0], [1.2, 1.0]])), expected)


def test_a_longer_demonstration_than_any_is_refused(model):
    longer = demonstrations(longest=T + 3, horizon=None)[2]
    with pytest.raises(ValueError, match=r"1 of the demonstrations have up to 11 steps; this mode"):
        infer(model, DemonstrationDataset(longer.observation, longer.action))


def test_an_environment_that_ends_early_is_noticed_though_no_demonstration_did():
    """Such as experts that never fall."""
    whole = demonstrations(count=3)  # none of them is fast enough to arrive
    whole = DemonstrationDataset(whole.observation, whole.action)
    assert not whole.ended.any()
    assert ends_early(make, T, 0)
    assert not ends_early(lambda n, seed: Door(n, math.inf), T, 0)
    assert meta_train(make, whole, **FEW).config.absorbing
    assert not meta_train(lambda n, seed: Door(n, math.inf), whole, **FEW).config.absorbing


class Gate(gymnasium.Env):
    """:class:`Door` in Gymnasium's terms."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (1,), np.float64)
    action_space = gymnasium.spaces.Box(-2.0, 2.0, (1,), np.float64)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.position = np.zeros(1)
        self.left = False
        return self.position.copy(), {}

    def step(self, action):
        assert not self.left, "stepped after its end"
        self.position = self.position + 0.3 * action
        self.left = bool(abs(self.position[0]) > 1)
        return self.position.copy(), 1.0, self.left, False, {}


@pytest.mark.parametrize(
    "make_env",
    [
        lambda n, seed: Gate(),
        lambda n, seed: SyncVectorEnv([Gate] * n, autoreset_mode=AutoresetMode.DISABLED),
        lambda n, seed: SyncVectorEnv([Gate] * n, autoreset_mode=AutoresetMode.SAME_STEP),
    ],
    ids=["single", "vector", "same step"],
)
def test_gymnasium_environments_go_on(make_env):
    trained = meta_train(make_env, demonstrations(), **FEW)
    assert trained.config.absorbing


def test_a_time_limit_is_not_an_end(model):
    """Truncation before T is refused, as ever: it says nothing of what would have followed."""
    with pytest.raises(
        ValueError, match=r"end at steps \[5\].*A time limit is that of the longest"
    ):
        adapt(
            model,
            demonstrations()[0],
            lambda n, seed: TransformedEnv(Door(n, 99.0), StepCounter(5)),
        )


# --- what was cut ------------------------------------------------------------------------------


def test_cut_demonstrations_need_an_encoder_of_any_length():
    cut = demonstrations(terminated=False)
    config = meta_training_config(cut, overrides=FEW)
    assert config.model.encoder == "attention"
    assert not config.model.absorbing
    endless = lambda n, seed: Door(n, math.inf)  # noqa: E731
    trained = meta_train(endless, cut, **FEW)
    assert math.isfinite(float(trained.encoder.get_dist(cut).mean.detach().sum()))
    assert infer(trained, cut[3]).context.shape == (3,)
    with pytest.raises(
        ValueError, match="of these have padding; give the model encoder='attention'"
    ):
        meta_train(endless, cut, **FEW, model={"encoder": "flat"})


def test_a_map_of_observations_does_not_see_padding():
    cut = demonstrations(terminated=False)
    fitted = new_model(cut, MethodConfig()).standardize
    batch = cut.trajectories()
    rows = batch["observation"][batch["mask"]]
    torch.testing.assert_close(fitted.loc, rows.mean(0))
    with pytest.raises(ValueError, match=r"a model of absorbing states .* needs demonstrations wi"):
        new_model(cut, MethodConfig(model=ModelConfig(absorbing=True)))


def test_the_discriminator_reads_neither_padding_nor_what_the_policy_did_then():
    cut = demonstrations(terminated=False)
    batch = cut.trajectories()
    batch["observation"][~batch["mask"]] = 7.0
    shape = (16, T)
    time = torch.arange(float(T)).view(1, T, 1).expand(*shape, 1)
    negatives = Negatives(1)
    filler = {"action": time, "context": torch.zeros(*shape, 3), "next": {"observation": time}}
    negatives.add(
        TensorDict({"observation": time, "action_log_prob": time[..., 0], **filler}, shape)
    )
    config = MethodConfig(model=ModelConfig(encoder="attention"))
    draw = DiscriminatorBatches(new_model(cut, config), batch, negatives, BatchConfig())
    expert, policy = draw.sample(1).chunk(2)
    assert (expert["observation"] != 7.0).all()
    # The policy's times are those of demonstrations: late steps are as rare on both sides.
    for t in range(T):
        share = float((batch["mask"].sum(1) > t).float().div(batch["mask"].sum(1)).mean())
        got = float((policy["observation"] == t).float().mean())
        assert got == pytest.approx(share, abs=0.06)


# --- after an end ------------------------------------------------------------------------------


def test_actions_after_an_end_are_none_with_the_policys_mean_log_density(model, rollouts):
    absorbing = rollouts["absorbing"]
    assert (rollouts["action"][absorbing] == 0).all()
    entropy = model.policy.get_dist(rollouts.copy()).entropy()
    torch.testing.assert_close(rollouts["action_log_prob"][absorbing], -entropy[absorbing])
    drawn = model.policy.get_dist(rollouts.copy()).log_prob(rollouts["action"])
    alive = ~absorbing
    torch.testing.assert_close(rollouts["action_log_prob"][alive], drawn[alive])


@pytest.mark.parametrize("relative", [False, True])
def test_expert_and_policy_look_alike_after_an_end(model, rollouts, relative):
    """Nothing but where the episode ended tells the two apart."""
    negatives = Negatives(1)
    negatives.add(rollouts)
    batch = demonstrations().with_absorbing_states().trajectories()
    config = BatchConfig(relative_log_prob=relative, jitter_fraction=1.0, jitter_scale=2.0)
    drawn = DiscriminatorBatches(model, batch, negatives, config).sample(1)
    ended = drawn["observation"][:, -1]
    assert set(ended.tolist()) == {0.0, 1.0}  # blur leaves the indicator as it is
    expert, policy = (drawn[(ended == 1) & (drawn["is_expert"] == side)] for side in (True, False))
    assert len(expert) > 20
    assert len(policy) > 20
    for key in ("action", "action_log_prob"):
        assert len(torch.cat([expert[key], policy[key]]).unique()) == 1


def test_what_an_end_is_worth_does_not_depend_on_the_units_of_actions(model, rollouts):
    """Densities do: all log pi move by the same, before an end and after it."""
    policy, inputs = model.policy, rollouts.select(*model.policy.in_keys)
    before = policy.get_dist(inputs.copy())
    shift = math.log(1000.0)  # millimetres
    scaled = torch.distributions.Independent(
        torch.distributions.Normal(1000 * before.mean, 1000 * before.stddev), 1
    )
    moved = before.log_prob(rollouts["action"]) - scaled.log_prob(1000 * rollouts["action"])
    torch.testing.assert_close(moved, torch.full_like(moved, shift), atol=1e-4, rtol=0)
    after = scaled.entropy() - before.entropy()
    torch.testing.assert_close(after, torch.full_like(after, shift), atol=1e-4, rtol=0)


def test_no_policy_is_trained_by_actions_that_did_nothing(model, rollouts):
    results = []
    for value in (0.0, 50.0):
        batch = rollouts.clone()
        batch["action"][batch["absorbing"]] = value
        batch["loc"][batch["absorbing"]] += value
        policy = model.trained_policy()
        torch.manual_seed(0)
        TRPO(policy, TRPOConfig(), 2)(batch)
        results.append(torch.cat([p.detach().flatten() for p in policy.parameters()]))
    assert torch.equal(*results)


def test_the_true_return_ends_with_the_episode(rollouts):
    steps = (~rollouts["absorbing"]).sum(1)
    assert torch.equal(rollouts["next", "reward"].sum(1).squeeze(-1), steps.float())
