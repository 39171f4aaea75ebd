"""Does PEMIRL learn what it is for? A statistical verdict on a problem with a known answer."""

import pytest
import torch
from tensordict import TensorDict

from pemirl_trl.methods import (
    BatchConfig,
    MetaIL,
    MetaILConfig,
    PolicyConfig,
    TRPOConfig,
    train,
)

SEEDS = (3, 4, 5)  # the settings below were chosen on others
GOALS = 20  # unseen, per seed
SHUFFLES = 1999


def meta_trained(problem, seed):
    """Meta-IL, then 40 iterations of the paper's Algorithm 1 on 20 contexts x 8 rollouts."""
    model = problem.model(seed)
    fresh = problem.model(seed + 100).policy.state_dict()
    config = MetaILConfig(steps=600, steps_per_iteration=100, kl_coeff=0.01)
    train(MetaIL(model, problem.demonstrations, config))
    model.policy.load_state_dict(fresh)
    method = problem.pemirl(
        model=model,
        contexts=20,
        rollouts_per_context=8,
        iterations=40,
        info_contexts=10,
        batch=BatchConfig(trajectories=100, time_steps=5),
        policy=PolicyConfig(trpo=TRPOConfig(max_kl=0.05)),
    )
    train(method)
    return model


def returns(problem, policy, context):
    """True return of the policy's mean action under these contexts, one per task."""
    env, total = problem.make(len(context)), 0.0
    data = env.reset(TensorDict({"task": problem.tasks}, env.batch_size))
    for _ in range(problem.horizon):
        data = env.step(policy(data.set("context", context)))
        total = total + data["next", "reward"]
        data = data["next"].exclude("reward")
    return total.squeeze(-1)


@pytest.mark.long
def test_the_reward_of_an_unseen_demonstration_peaks_at_its_goal(make_reach):
    """Sixty goals that meta-training never saw, three seeds, two verdicts, fixed beforehand.

    Reward: the distance between the goal and the argmax of r(., m_hat) over [-1.25, 1.25] m, m_hat
    inferred from one demonstration. Under the null hypothesis that the peak knows nothing of the
    goal, peaks may be exchanged among the goals of a seed: the mean distance must be smaller than
    after all but 1 % of exchanges (permutation test). Policy: the true return under m_hat must
    beat that of an untrained policy on so many goals that a fair coin would do it with
    probability below 1 % (sign test).
    """
    train_goals = torch.linspace(-1.0, 1.0, 60).unsqueeze(-1)
    grid = torch.linspace(-1.25, 1.25, 251).unsqueeze(-1)
    peaks, goals, wins = [], [], 0
    for seed in SEEDS:
        model = meta_trained(make_reach(train_goals, noise=0.3), seed)
        torch.manual_seed(1000 + seed)
        unseen = make_reach(2.0 * torch.rand(GOALS, 1) - 1.0, noise=0.3)
        with torch.no_grad():
            m = model.encoder.get_dist(unseen.demonstrations).mean
            pairs = (GOALS, len(grid), -1)
            reward = model.reward.reward(grid.expand(*pairs), m.unsqueeze(1).expand(*pairs))
            peaks.append(grid[reward.squeeze(-1).argmax(1), 0])
            goals.append(unseen.tasks["goal"].squeeze(-1))
            untrained = returns(unseen, unseen.model(seed + 200).policy, m)
            wins += int((returns(unseen, model.policy, m) > untrained).sum())

    peak, goal = torch.stack(peaks), torch.stack(goals)  # [seeds, GOALS]
    distance = (peak - goal).abs().mean()
    exchanged = torch.stack(
        [(peak[:, torch.randperm(GOALS)] - goal).abs().mean() for _ in range(SHUFFLES)]
    )
    p_reward = (1 + int((exchanged <= distance).sum())) / (1 + SHUFFLES)
    n = goal.numel()
    coin = torch.distributions.Binomial(n, 0.5)
    p_policy = float(coin.log_prob(torch.arange(wins, n + 1.0)).exp().sum())
    facts = (
        f"distance of the peak {distance:.3f} m, by chance {exchanged.mean():.3f} m, "
        f"p {p_reward:.4f}; policy better than untrained on {wins} of {n}, p {p_policy:.1e}"
    )
    print(facts)
    assert p_reward < 0.01, facts
    assert p_policy < 0.01, facts
