"""Our TRPO against sb3-contrib's on gymnasium's Pendulum-v1, as a statistical verdict.

Fixed before the runs on these seeds (others served to choose the length): 5 seeds each, 16
environments of 200 steps, 40 updates, which is 128,000 steps. Both: tanh networks of 2 x 64, a
deviation that starts at 1, a critic by 10 epochs of Adam, gamma 0.9, lambda 0.95, 0.02 nats,
damping 0.1, 15 iterations of the conjugate gradient. The score of a run is the mean return of the
episodes of its last 5 updates, with actions as sampled in training; never a best.

Verdict: ours is not worse by more than 150, of the 1,000 or so that learning gains, if Welch's
one-sided test rejects "ours <= theirs - 150" at 5 %.
"""

import gymnasium
import numpy as np
import pytest
import scipy.stats
import torch
from sb3_contrib import TRPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from tensordict import TensorDict
from torchrl.data import Binary, Composite, Unbounded
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type

from pemirl_trl.modules import ContextPolicy, ContextValue
from pemirl_trl.objectives import FiniteHorizonAdvantage, TRPOLoss, ValueLoss
from pemirl_trl.optim import TrustRegionOptimizer, descend

SEEDS, ENVS, HORIZON, UPDATES, LAST = range(5), 16, 200, 40, 5
GAMMA, LMBDA, MAX_KL, DAMPING, CG_ITERATIONS = 0.9, 0.95, 0.02, 0.1, 15
CRITIC_LR, CRITIC_EPOCHS, MINIBATCHES = 1e-3, 10, 8
MARGIN, LEVEL = 150.0, 0.05


class Pendulums(EnvBase):
    """gymnasium's Pendulum-v1, with a context that says nothing."""

    batch_locked = True

    def __init__(self, seed):
        super().__init__(batch_size=[ENVS])
        self.envs = [gymnasium.make("Pendulum-v1") for _ in range(ENVS)]
        self.seeds = [seed * ENVS + i for i in range(ENVS)]
        shape = self.batch_size
        self.observation_spec = Composite(
            observation=Unbounded((*shape, 3)), context=Unbounded((*shape, 1)), shape=shape
        )
        self.action_spec = Unbounded((*shape, 1))
        self.reward_spec = Unbounded((*shape, 1))
        flags = ("done", "terminated", "truncated")
        self.full_done_spec = Composite(
            {key: Binary(1, (*shape, 1), dtype=torch.bool) for key in flags}, shape=shape
        )

    def _set_seed(self, seed):
        """The constructor's seeds hold."""

    def _reset(self, tensordict=None, **kwargs):
        pairs = zip(self.envs, self.seeds, strict=True)
        observations = [env.reset(seed=seed)[0] for env, seed in pairs]
        self.seeds = [None] * ENVS  # gymnasium's own streams go on from the first seeds
        return self._state(observations, False)

    def _step(self, tensordict):
        # Actions beyond the limits are clipped, as sb3 does before it steps.
        actions = tensordict["action"].clamp(-2.0, 2.0).numpy()
        steps = [env.step(action) for env, action in zip(self.envs, actions, strict=True)]
        observations, rewards, _, truncated, _ = zip(*steps, strict=True)
        state = self._state(observations, truncated[0])
        return state.set("reward", torch.tensor(rewards, dtype=torch.float32).unsqueeze(-1))

    def _state(self, observations, truncated):
        flag = torch.full((ENVS, 1), truncated)
        return TensorDict(
            {
                "observation": torch.from_numpy(np.stack(observations)).float(),
                "context": torch.zeros(ENVS, 1),
                "done": flag,
                "terminated": torch.zeros_like(flag),
                "truncated": flag.clone(),
            },
            self.batch_size,
        )


def our_score(seed):
    torch.manual_seed(seed)
    env = Pendulums(seed)
    policy = ContextPolicy(3, 1, 1, activation=torch.nn.Tanh)
    value = ContextValue(3, 1, HORIZON)
    value_loss, policy_loss = ValueLoss(value), TRPOLoss(policy)
    advantage = FiniteHorizonAdvantage(gamma=GAMMA, lmbda=LMBDA, value=value)
    adam = torch.optim.Adam(value.parameters(), lr=CRITIC_LR)
    trust_region = TrustRegionOptimizer(
        policy.parameters(), max_kl=MAX_KL, damping=DAMPING, cg_iterations=CG_ITERATIONS
    )

    def update():
        with set_exploration_type(ExplorationType.RANDOM), torch.no_grad():
            episodes = advantage(env.rollout(HORIZON, policy))
        rows = episodes.reshape(-1)

        def closure():
            losses = policy_loss(rows)
            return losses["loss_objective"], losses["kl"]

        trust_region.step(closure)
        for _ in range(CRITIC_EPOCHS):
            for chosen in torch.randperm(ENVS).split(ENVS // MINIBATCHES):
                descend(adam, value_loss(episodes[chosen])["loss_value"])
        return episodes["next", "reward"].sum(1).mean().item()

    return np.mean([update() for _ in range(UPDATES)][-LAST:])


class Returns(BaseCallback):
    """Of every episode, in order."""

    def __init__(self):
        super().__init__()
        self.values = []

    def _on_step(self):
        self.values += [i["episode"]["r"] for i in self.locals["infos"] if "episode" in i]
        return True


def their_score(seed):
    model = TRPO(
        "MlpPolicy",
        make_vec_env("Pendulum-v1", n_envs=ENVS, seed=seed),
        n_steps=HORIZON,
        batch_size=ENVS * HORIZON // MINIBATCHES,
        gamma=GAMMA,
        gae_lambda=LMBDA,
        target_kl=MAX_KL,
        cg_damping=DAMPING,
        cg_max_steps=CG_ITERATIONS,
        n_critic_updates=CRITIC_EPOCHS,
        learning_rate=CRITIC_LR,
        seed=seed,
        device="cpu",
    )
    returns = Returns()
    model.learn(ENVS * HORIZON * UPDATES, callback=returns)
    return np.mean(returns.values[-LAST * ENVS :])


@pytest.mark.long
def test_ours_is_not_worse_than_sb3():
    ours, theirs = ([score(s) for s in SEEDS] for score in (our_score, their_score))
    test = scipy.stats.ttest_ind(
        np.add(ours, MARGIN), theirs, equal_var=False, alternative="greater"
    )
    verdict = f"ours {np.round(ours)}, sb3 {np.round(theirs)}, p {test.pvalue:.4f}"
    print(verdict)
    assert test.pvalue < LEVEL, verdict
