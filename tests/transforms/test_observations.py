"""Several entries of an observation as one vector, in the order of their names."""

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import EnvBase, TransformedEnv
from torchrl.envs.utils import check_env_specs

from pemirl_trl import JoinObservations

N = 3


class Arm(EnvBase):
    """Observes a matrix, a nested angle of float64 and an integer."""

    def __init__(self):
        super().__init__(batch_size=[N])
        arm = Composite(angle=Unbounded((N, 1), dtype=torch.float64), shape=[N])
        self.observation_spec = Composite(
            image=Unbounded((N, 2, 2)),
            arm=arm,
            count=Bounded(0, 9, (N, 1), dtype=torch.int64),
            shape=[N],
        )
        self.action_spec = Bounded(-1, 1, (N, 1))
        self.reward_spec = Unbounded((N, 1))

    def _observed(self):
        return TensorDict(
            {
                "image": torch.randn(N, 2, 2),
                "arm": {"angle": torch.randn(N, 1, dtype=torch.float64)},
                "count": torch.randint(10, (N, 1)),
            },
            [N],
        )

    def _reset(self, tensordict=None, **_):
        self.last = self._observed()
        return self.last.clone()

    def _step(self, tensordict):
        self.last = self._observed()
        end = {"reward": torch.zeros(N, 1), "done": torch.zeros(N, 1, dtype=torch.bool)}
        return self.last.clone().update(end)

    def _set_seed(self, seed):
        pass


def joined(keys):
    base = Arm()
    return TransformedEnv(base, JoinObservations(keys, base)), base


def test_entries_stand_in_a_row_flattened_and_of_one_type():
    env, base = joined(["count", "arm.angle", "image"])
    check_env_specs(env)
    data = env.reset()
    for _ in range(2):
        last = base.last
        expected = [last["count"], last["arm", "angle"], last["image"].flatten(1)]
        assert torch.equal(data["observation"], torch.cat([v.float() for v in expected], -1))
        assert "image" not in data
        data = env.step(data.set("action", torch.zeros(N, 1)))["next"].exclude("reward")


def test_what_is_not_named_stays():
    env, base = joined(["count"])
    assert torch.equal(env.reset()["image"], base.last["image"])


@pytest.mark.parametrize("keys", [["counts"], ["count", "count"], [], ["arm"]])
def test_keys_that_are_none_are_answered_with_those_that_are(keys):
    with pytest.raises(ValueError, match=r"expected different ones of \['arm.angle', 'count', 'i"):
        joined(keys)
