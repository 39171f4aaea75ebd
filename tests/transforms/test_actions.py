"""One-hot vectors of real numbers outside, what the environment takes inside."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Bounded, Categorical, Composite, OneHot, Unbounded
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.utils import check_env_specs

from pemirl_trl import OneHotActions

N = 3


class Taker(EnvBase):
    """Observes the index of the action that it took."""

    def __init__(self, spec):
        super().__init__(batch_size=[N])
        self.observation_spec = Composite(observation=Unbounded((N, 1)), shape=[N])
        self.action_spec = spec
        self.reward_spec = Unbounded((N, 1))

    def _reset(self, tensordict=None, **_):
        return TensorDict({"observation": torch.zeros(N, 1)}, [N])

    def _step(self, tensordict):
        action = tensordict["action"]
        assert self.action_spec.is_in(action)
        index = action.long().argmax(-1) if action.ndim == 2 else action
        seen = index.unsqueeze(-1).float()
        done = torch.zeros(N, 1, dtype=torch.bool)
        return TensorDict({"observation": seen, "reward": seen.clone(), "done": done}, [N])

    def _set_seed(self, seed):
        pass


SPECS = {
    "index": Categorical(4, shape=(N,)),
    "one-hot integers": OneHot(4, shape=(N, 4), dtype=torch.int64),
    "one-hot booleans": OneHot(4, shape=(N, 4), dtype=torch.bool),
}


@pytest.mark.parametrize("name", SPECS)
def test_the_chosen_action_is_the_one_that_is_taken(name):
    base = Taker(SPECS[name])
    env = TransformedEnv(base, OneHotActions.of(base))
    assert env.action_spec.dtype == torch.get_default_dtype()
    assert env.action_spec.shape == (N, 4)
    check_env_specs(env)
    chosen = torch.tensor([2, 0, 3])
    action = torch.nn.functional.one_hot(chosen, 4).float()
    after = env.step(env.reset().set("action", action))
    assert after["next", "observation"].flatten().tolist() == chosen.tolist()
    assert torch.equal(after["action"], action)  # what is stored is what the policy gave
    drawn = env.rollout(50)
    assert torch.equal(drawn["action"].argmax(-1).float(), drawn["next", "observation"][..., 0])


def test_continuous_actions_need_none_and_are_refused():
    spec = Bounded(-1, 1, (N, 2))
    assert OneHotActions.of(Taker(spec)) is None
    with pytest.raises(TypeError, match="expected OneHot or Categorical"):
        OneHotActions(spec)
