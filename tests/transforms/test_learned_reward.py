"""The learned reward is the module's, on a live environment as on a stored batch."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.envs import Compose, RewardSum, TransformedEnv
from torchrl.envs.utils import check_env_specs

from pemirl_trl.modules import ContextEncoder, PEMIRLModel, ShapedReward
from pemirl_trl.transforms import InferContext, LearnedReward

from .toy import Line

N, T, D = 4, 3, 2


@pytest.fixture
def reward():
    return ShapedReward(2, D)


@pytest.fixture
def make():
    demonstrations = TensorDict(
        {"observation": torch.randn(5, T, 2), "action": torch.randn(5, T, 1)}, [5]
    )
    infer = ContextEncoder(2, 1, D, T)

    def make_env(*transforms):
        return TransformedEnv(Line(N, T), Compose(InferContext(infer, demonstrations), *transforms))

    return make_env


each_reward = pytest.mark.parametrize("key", ["learned_reward", "shaped_reward"])


@each_reward
def test_live_is_the_module(make, reward, key):
    batch = make(LearnedReward(reward, key)).rollout(T)
    with torch.no_grad():
        expected = reward(batch.select(*reward.in_keys))[key]
    assert expected.std() > 0
    assert torch.allclose(batch["next", "reward"], expected)
    position = batch["next", "observation"][..., :1]
    assert torch.equal(batch["next", "true_reward"], -position.square())


@each_reward
def test_stored_is_the_module(make, reward, key):
    batch = make().rollout(T)
    true = batch["next", "reward"].clone()
    result = LearnedReward(reward, key)(batch)
    assert result is batch
    assert torch.equal(result["next", "reward"], reward(batch.select(*reward.in_keys))[key])
    assert torch.equal(result["next", "true_reward"], true)
    assert not result["next", "reward"].requires_grad


def test_scoring_again_uses_the_new_weights_and_keeps_the_true_reward(make, reward):
    batch, transform = make().rollout(T), LearnedReward(reward)
    true = batch["next", "reward"].clone()
    first = transform(batch)["next", "reward"].clone()
    with torch.no_grad():
        for parameter in reward.parameters():
            parameter.add_(0.1)
    second = transform(batch)["next", "reward"]
    assert not torch.allclose(second, first)
    assert torch.equal(batch["next", "true_reward"], true)


def test_a_live_environment_sees_new_weights(make, reward):
    env = make(LearnedReward(reward))
    with torch.no_grad():
        for parameter in reward.reward_net.parameters():
            parameter.zero_()
        reward.reward_net[-1].bias.fill_(7.0)
    assert (env.rollout(T)["next", "reward"] == 7.0).all()


def test_nothing_but_the_rewards_is_written(make, reward):
    plain = set(make().rollout(T).keys(True, True))
    keys = set(make(LearnedReward(reward)).rollout(T).keys(True, True))
    assert keys - plain == {("next", "true_reward")}


@each_reward
def test_specs_hold_and_both_rewards_can_be_summed(make, reward, key):
    sums = RewardSum(in_keys=["reward", "true_reward"], out_keys=["learned_sum", "true_sum"])
    env = make(LearnedReward(reward, key), sums)
    check_env_specs(env)
    batch = env.rollout(T)
    for name, total in (("reward", "learned_sum"), ("true_reward", "true_sum")):
        assert torch.allclose(batch["next", total][:, -1], batch["next", name].sum(1))


def test_an_unknown_reward_is_refused(reward):
    with pytest.raises(ValueError, match=r"'r'; this reward writes \['learned_reward', 'shaped"):
        LearnedReward(reward, "r")


def test_a_model_is_pointed_to_its_reward():
    with pytest.raises(
        TypeError, match=r"takes a TensorDict module, got PEMIRLModel: pass its \.r"
    ):
        LearnedReward(PEMIRLModel(2, 1, T))


def test_a_flat_batch_is_scored_as_the_rollouts_are(make, reward):
    batch = make().rollout(T)
    flat = LearnedReward(reward)(batch.reshape(-1))
    expected = LearnedReward(reward)(batch)
    assert torch.allclose(flat["next", "reward"], expected["next", "reward"].flatten(0, 1))


@pytest.mark.parametrize(
    ("key", "message"),
    [("context", "InferContext writes it"), (("next", "reward"), "Environments write it")],
)
def test_what_a_batch_lacks_is_explained(make, reward, key, message):
    batch = make().rollout(T).exclude(key)
    with pytest.raises(KeyError, match=rf"LearnedReward reads .*batch lacks.*{message}"):
        LearnedReward(reward)(batch)
