"""Maximum-entropy control on a listed problem: Lemma 1, AIRL's fixed point, telescoping."""

import pytest
import torch
from tensordict import TensorDict

from pemirl_trl.functional import logit_expert
from pemirl_trl.modules import AIRLDiscriminator, ShapedReward

from .finite_mdp import FiniteMDP

pytestmark = pytest.mark.usefixtures("float64")


@pytest.fixture
def mdp(float64):
    torch.manual_seed(5)
    return FiniteMDP.random(states=5, actions=3, contexts=3, horizon=4)


def test_lemma_1_the_optimal_policy_induces_the_trajectory_distribution(mdp):
    shaped = mdp.shaped(ShapedReward(3, 2, gamma=0.9))
    shaped = shaped + torch.randn_like(shaped)  # any f, not only one that is a shaped reward
    log_policy, values = mdp.soft_value_iteration(shaped)
    induced = mdp.policy_log_probability(log_policy)
    assert torch.allclose(induced.exp(), mdp.trajectory_probability(shaped), rtol=1e-12)
    assert torch.allclose(values[0, :, 0], mdp.returns(shaped).logsumexp(-1))  # log Z(theta)
    other = mdp.policy_log_probability(torch.randn_like(log_policy).log_softmax(-1))
    assert (other.exp() - mdp.trajectory_probability(shaped)).abs().max() > 1e-3


def test_the_logit_of_the_soft_advantage_is_zero_on_the_optimal_policy(mdp):
    reward = torch.randn(len(mdp.contexts), *mdp.next_state.shape)
    log_policy, values = mdp.soft_value_iteration(reward)
    following = values[1:, :, mdp.next_state]  # [T, M, S, A]
    advantage = reward + following - values[:-1].unsqueeze(-1)
    assert logit_expert(advantage, log_policy).abs().max() < 1e-12


def discounted_soft_values(reward, next_state, gamma, sweeps=400):
    """V(s) and log pi*(a|s) of a state reward ``[S]`` without horizon."""
    value = torch.zeros_like(reward)
    for _ in range(sweeps):
        q = reward.unsqueeze(-1) + gamma * value[next_state]
        value = q.logsumexp(-1)
    return value, q - value.unsqueeze(-1)


def test_airl_is_at_chance_where_reward_and_potential_are_the_true_ones(mdp):
    """With r the reward and h its soft value, f = r + gamma h' - h is the soft advantage."""
    states, actions = mdp.next_state.shape
    gamma = 0.9
    reward = torch.randn(states)
    value, log_policy = discounted_soft_values(reward, mdp.next_state, gamma)
    network = ShapedReward(states, 0, gamma=gamma, hidden=())  # linear in one-hot states: tabular
    one_hot = torch.eye(states)
    with torch.no_grad():
        for net, table in ((network.reward_net, reward), (network.potential_net, value)):
            net[0].weight.copy_(table.unsqueeze(0))
            net[0].bias.zero_()
    batch = TensorDict(
        {
            "observation": one_hot[:, None].expand(-1, actions, -1),
            "next": {"observation": one_hot[mdp.next_state]},
            "context": torch.zeros(states, actions, 0),
            "action_log_prob": log_policy,
        },
        [states, actions],
    )
    assert AIRLDiscriminator(network)(batch)["logit_expert"].abs().max() < 1e-12
    batch["action_log_prob"] = torch.randn(states, actions).log_softmax(-1)
    assert AIRLDiscriminator(network)(batch)["logit_expert"].abs().max() > 0.1


@pytest.mark.parametrize("gamma", [1.0, 0.9])
def test_potentials_telescope(mdp, gamma):
    network = ShapedReward(3, 2, gamma=gamma)
    everything = torch.arange(len(mdp.action_index))
    context = mdp.contexts[:1].expand(len(everything), -1)
    batch = network(mdp.rollouts(everything, context))
    discount = gamma ** torch.arange(mdp.horizon)
    shaping = ((batch["shaped_reward"] - batch["learned_reward"]).squeeze(-1) * discount).sum(-1)
    first, last = (mdp.observations[mdp.state_index[:, t]] for t in (0, -1))
    potential = network.potential(first, context), network.potential(last, context)
    expected = gamma**mdp.horizon * potential[1] - potential[0]
    assert shaping.std() > 1e-3
    assert torch.allclose(shaping, expected.squeeze(-1), atol=1e-12)
