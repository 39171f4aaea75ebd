"""An environment that ends early goes on to T where it ended, and pays nothing for that."""

import gymnasium
import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import Compose, EnvBase, GymEnv, StepCounter, TransformedEnv, check_env_specs

from pemirl_trl import AbsorbingState, DemonstrationDataset, Provenance, wrap_gymnasium

T = 8


class Cliff(EnvBase):
    """Environment i terminates after ``ends[i]`` steps, and is truncated after ``cuts[i]``.

    It goes on counting (and soon says NaN) when it is stepped beyond; r = 1 at every step.
    """

    def __init__(self, ends, cuts=None):
        n = len(ends)
        super().__init__(batch_size=[n])
        self.ends = torch.tensor(ends).unsqueeze(-1)
        self.cuts = torch.tensor(cuts or [99] * n).unsqueeze(-1)
        self.observation_spec = Composite(observation=Unbounded((n, 2)), shape=[n])
        self.action_spec = self.reward_spec = Unbounded((n, 1))
        one = Binary(1, (n, 1), dtype=torch.bool)
        flags = {k: one.clone() for k in ("done", "terminated", "truncated")}
        self.full_done_spec = Composite(flags, shape=[n])

    def _set_seed(self, seed):
        """Nothing is random."""

    def _reset(self, tensordict=None, **kwargs):
        self.time = torch.zeros_like(self.ends)
        return self.state().exclude("reward")

    def _step(self, tensordict):
        assert tensordict["observation"].shape[-1] == 2  # its own, should it read it back
        self.time = self.time + 1
        return self.state()

    def state(self):
        time = self.time.float()
        observation = torch.cat([time, -time], -1)
        observation[(self.time > self.ends + 2).squeeze(-1)] = torch.nan
        terminated, truncated = self.time == self.ends, self.time == self.cuts
        flags = {"done": terminated | truncated, "terminated": terminated, "truncated": truncated}
        reward = torch.ones(self.ends.shape)
        return TensorDict({"observation": observation, "reward": reward, **flags}, self.batch_size)


def whole(env, horizon=T):
    env = TransformedEnv(env, Compose(AbsorbingState(), StepCounter(horizon)))
    return env.rollout(horizon, break_when_any_done=False)


def test_by_hand():
    rollouts = whole(Cliff([3, 99, 8, 1]))
    assert rollouts["absorbing"].sum(1).tolist() == [5, 0, 0, 7]
    seen = rollouts["observation"][0]
    assert seen[:, 0].tolist() == [0, 1, 2, 3, 3, 3, 3, 3]
    assert seen[:, -1].tolist() == [0, 0, 0, 1, 1, 1, 1, 1]
    assert rollouts["next", "observation"][0, :, -1].tolist() == [0, 0, 1, 1, 1, 1, 1, 1]
    assert rollouts["next", "reward"].sum(1).flatten().tolist() == [3, 8, 8, 1]
    done = rollouts["next", "done"].squeeze(-1)
    assert done[:, -1].all()
    assert not done[:, :-1].any()
    assert not rollouts["next", "terminated"].any()
    # An end at T itself is seen, though no step begins there.
    assert rollouts["next", "observation"][2, -1, -1] == 1


def test_an_episode_rolled_out_is_the_same_episode_demonstrated():
    """The law that makes expert and policy comparable after an end."""
    ends = [3, 99, 7, 1]
    rollouts = whole(Cliff(ends))
    lengths = [min(n, T) for n in ends]
    pairs = [
        (
            torch.stack([torch.arange(n + 1.0), -torch.arange(n + 1.0)], -1),
            rollouts["action"][i, :n],
        )
        for i, n in enumerate(lengths)
    ]
    demos = DemonstrationDataset.from_episodes(pairs, Provenance()).with_absorbing_states()
    expected = demos.trajectories()
    for key in ("observation", "absorbing", ("next", "observation")):
        assert torch.equal(rollouts[key], expected[key]), key


def test_a_cut_is_not_an_end():
    rollouts = whole(Cliff([99, 2], cuts=[4, 5]))
    truncated = rollouts["next", "truncated"].squeeze(-1)
    assert truncated[0, 3]
    # After an end nobody can stop looking: the episode goes on to T.
    assert not truncated[1, :-1].any()
    assert rollouts["absorbing"][1].sum() == T - 2


def test_the_specs_are_those_of_what_comes():
    check_env_specs(TransformedEnv(Cliff([3, 99]), Compose(AbsorbingState(), StepCounter(T))))


@pytest.mark.filterwarnings("ignore:.*You are calling 'step:UserWarning")
@pytest.mark.parametrize("vector", [False, True])
def test_gymnasium(vector):
    if vector:
        mode = gymnasium.vector.AutoresetMode.DISABLED
        made = gymnasium.vector.SyncVectorEnv(
            [lambda: gymnasium.make("CartPole-v1")] * 3, autoreset_mode=mode
        )
        env = wrap_gymnasium(made)
    else:
        env = GymEnv("CartPole-v1")
    env = TransformedEnv(env, Compose(AbsorbingState(), StepCounter(300)))
    env.set_seed(0)
    rollouts = env.rollout(300, break_when_any_done=False)
    assert rollouts.shape[-1] == 300
    absorbing = rollouts["absorbing"]
    assert absorbing[..., -1].all()
    assert not absorbing[..., 0].any()
    last = rollouts["observation"][..., -1, :]
    assert torch.equal(rollouts["observation"][..., -2, :], last)
    assert (rollouts["next", "reward"].squeeze(-1) == (~absorbing).float()).all()
