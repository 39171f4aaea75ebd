"""One iteration of Algorithm 1: what it may depend on, and which network each loss may move."""

import copy
from dataclasses import replace

import pytest
import torch
from torch.distributions import Independent, Normal

from pemirl_trl.data import DemonstrationDataset
from pemirl_trl.methods import MetaIL, MetaILConfig, PolicyConfig, TRPOConfig

NETWORKS = ("encoder", "reward", "policy")


def weights(module):
    return {name: value.clone() for name, value in module.state_dict().items()}


def changed(model, before):
    """Which of the model's networks moved since ``before``."""
    now = weights(model)
    moved = {n for n, value in now.items() if not torch.equal(value, before[n])}
    return {network for network in NETWORKS if any(n.startswith(network) for n in moved)}


def run(method, iterations=1, seed=3):
    torch.manual_seed(seed)
    metrics = [method.iteration() for _ in range(iterations)]
    return weights(method.model), metrics


# --- nothing but the demonstrations, the seed and the rollouts counts -------------------------


def labelled(problem, order):
    """The demonstrations as a dataset, with their task labels in this order."""
    demonstrations = problem.demonstrations
    last = demonstrations["next", "observation"][:, -1:]
    observation = torch.cat([demonstrations["observation"], last], 1)
    return DemonstrationDataset(observation, demonstrations["action"], task=problem.tasks[order])


def test_permuted_task_labels_change_no_parameter(maze, differences):
    order = torch.arange(len(maze.tasks)).roll(1)
    true, permuted = labelled(maze, torch.arange(len(order))), labelled(maze, order)

    def after(dataset):
        problem = replace(maze, demonstrations=dataset.trajectories())
        return run(problem.pemirl(tasks=dataset.tasks()), 2)

    (parameters, metrics), (others, other_metrics) = after(true), after(permuted)
    assert differences(parameters, others) == []
    # The labels did reach the environment, where they make the true return: a metric.
    assert metrics[0]["return/true"] != other_metrics[0]["return/true"]
    del metrics[0]["return/true"], other_metrics[0]["return/true"]
    assert metrics[0] == other_metrics[0]


def test_permuted_task_labels_do_not_reach_meta_il(maze, differences):
    def after(order):
        demonstrations = labelled(maze, order).trajectories()
        method = MetaIL(maze.model(), demonstrations, MetaILConfig(steps=2, steps_per_iteration=2))
        return run(method)[0]

    order = torch.arange(len(maze.tasks))
    assert differences(after(order), after(order.roll(1))) == []


def test_permuted_demonstrations_do_change_the_parameters(maze, differences):
    permuted = replace(maze, demonstrations=maze.demonstrations.roll(1, 0))

    def both(problem):
        config = MetaILConfig(steps=2, steps_per_iteration=2, batch_size=3)
        meta_il = MetaIL(problem.model(), problem.demonstrations, config)
        return run(problem.pemirl())[0], run(meta_il)[0]

    for parameters, others in zip(both(maze), both(permuted), strict=True):
        assert differences(parameters, others)


def test_the_number_of_simulation_threads_changes_nothing(maze, differences):
    one, two = (run(maze.pemirl(env={"num_threads": n})) for n in (1, 2))
    assert differences(one[0], two[0]) == []
    assert one[1] == two[1]


def test_the_seed_decides_everything(reach, differences):
    first, second, other = (run(reach.pemirl(), 2, seed) for seed in (3, 3, 4))
    assert differences(first[0], second[0]) == []
    assert first[1] == second[1]
    assert differences(first[0], other[0])


# --- each network moves by its own rule -------------------------------------------------------


@pytest.mark.parametrize(
    ("frozen", "config"),
    [
        ("encoder", {"encoder_lr": 0.0, "encoder_gradient": True}),
        ("reward", {"encoder_lr": 1e-4, "reward_lr": 0.0, "gradient_penalty_coeff": 1.0}),
        ("policy", {"encoder_lr": 1e-4, "policy": PolicyConfig(trpo=TRPOConfig(max_kl=1e-30))}),
    ],
)
def test_each_network_has_one_optimiser(frozen, config, reach):
    method = reach.pemirl(**config)
    before = weights(method.model)
    metrics = run(method)[1]
    assert changed(method.model, before) == set(NETWORKS) - {frozen}
    assert metrics[0]["trpo/accepted"] == (frozen != "policy")


def encoder_after(problem, **config):
    model = problem.model()
    run(problem.pemirl(model=model, **config))
    return weights(model.encoder)


def encoder_beside_another_reward(problem, **config):
    model = problem.model()
    model.reward.load_state_dict(problem.model(seed=1).reward.state_dict())
    run(problem.pemirl(model=model, **config))
    return weights(model.encoder)


def test_psi_moves_by_the_information_loss_alone(reach, differences):
    # The reward makes the classification loss and Lemma 2's, but not -E log q(m|tau).
    base = {"encoder_lr": 1e-4}
    after = encoder_after(reach, **base)
    assert differences(after, encoder_beside_another_reward(reach, **base)) == []
    assert differences(after, encoder_after(reach, info_coeff=5.0, **base)) == []


def test_the_discriminator_trains_psi_where_it_is_told_to(reach, differences):
    base = {"encoder_lr": 1e-4}
    on = base | {"encoder_gradient": True}
    assert differences(encoder_after(reach, **on), encoder_beside_another_reward(reach, **on))
    assert differences(encoder_after(reach, **on), encoder_after(reach, **base))


def test_psi_descends_its_loss(reach):
    # All contexts are in every step's batch, so that the losses of two steps compare.
    (_, [first]), (_, [last]) = (
        run(reach.pemirl(reward_steps=steps, encoder_lr=1e-3)) for steps in (1, 40)
    )
    assert last["reward/log_q"] > first["reward/log_q"]


def test_a_weight_of_the_information_term_reaches_theta(reach, differences):
    def reward_after(**config):
        return {n: v for n, v in run(reach.pemirl(**config))[0].items() if n.startswith("reward")}

    without = reward_after(info_coeff=0.0)
    assert differences(without, reward_after(info_coeff=0.0)) == []
    assert differences(without, reward_after(info_coeff=0.1))


def test_the_rewards_learning_rate_fades_out_while_the_policy_is_annealed(reach):
    policy = PolicyConfig(anneal_begin=0.5)
    method = reach.pemirl(iterations=5, reward_lr=1e-2, final_reward_lr=1e-4, policy=policy)
    rates = []
    for _ in range(5):
        method.iteration()
        rates.append(method._reward_optimizer.param_groups[0]["lr"])
    assert rates == pytest.approx([1e-2, 1e-2, 1e-2, 1e-3, 1e-4])


def test_the_policy_takes_its_steps_on_point_maze(maze):
    method = maze.pemirl(contexts=4, rollouts_per_context=3)
    _, metrics = run(method, 10)
    accepted = [m["trpo/accepted"] for m in metrics]
    assert sum(accepted) >= 8
    for m in metrics:
        assert 0.0 <= m["trpo/kl"] <= method.config.policy.trpo.max_kl
        assert m["trpo/improvement"] > 0.0 or not m["trpo/accepted"]


def test_negatives_keep_the_context_and_the_density_of_their_collection(reach):
    method = reach.pemirl(contexts=3, rollouts_per_context=2)
    torch.manual_seed(0)
    policies = []
    for _ in range(3):
        policies.append(copy.deepcopy(method.model.policy))
        method.iteration()

    stored = method.sampler.negatives.state_dict()  # [3, N, T, ...], oldest first
    context = stored["context"]
    assert torch.equal(context, context[:, :, :1].expand_as(context))  # along a rollout
    groups = context[:, :, 0].unflatten(1, (3, 2))
    assert torch.equal(groups[:, :, 0], groups[:, :, 1])  # K rollouts of one m
    assert len(groups[:, :, 0].flatten(0, 1).unique(dim=0)) == 9  # another for each of the M
    for i, policy in enumerate(policies):
        inputs = {"observation": stored["observation"][i], "context": context[i]}
        loc = policy.gaussian.net(
            policy.gaussian.standardize(inputs["observation"]), inputs["context"]
        )
        at_collection = Independent(Normal(loc, policy.log_scale.exp()), 1)
        torch.testing.assert_close(
            stored["action_log_prob"][i], at_collection.log_prob(stored["action"][i])
        )


def test_the_imitation_loss_shows_each_demonstration_its_own_context(reach):
    method = reach.pemirl(contexts=3, policy=PolicyConfig(imitation_coeff=0.5))
    torch.manual_seed(0)
    rollouts = method.sampler.collect()[0]
    loss = method.sampler.imitation_loss(rollouts)()
    expected = []
    for row in range(0, 6, 2):
        demonstration = reach.demonstrations[int(rollouts["demonstration"][row, 0])]
        policy = method.model.policy
        loc = policy.gaussian.net(
            policy.gaussian.standardize(demonstration["observation"]), rollouts["context"][row]
        )
        expected.append(Normal(loc, policy.log_scale.exp()).log_prob(demonstration["action"]))
    torch.testing.assert_close(loss, -0.5 * torch.stack(expected).sum(-1).mean())
    off = reach.pemirl(policy=PolicyConfig(imitation_coeff=0.0))
    assert off.sampler.imitation_loss(rollouts) is None


# --- losses that move nothing are not computed ------------------------------------------------


@pytest.mark.parametrize("settings", [{"info_coeff": 0.0}, {}])
def test_an_encoder_at_rest_costs_no_step_and_changes_nothing_but_rounding(settings, maze):
    """Its q is inferred of all demonstrations at once: in other blocks, on some kinds of CPU."""
    resting, all_but = (maze.pemirl(encoder_lr=lr, **settings) for lr in (0.0, 1e-38))
    (parameters, metrics), (others, other_metrics) = run(resting), run(all_but)
    assert not resting._encoder_optimizer.state
    assert all_but._encoder_optimizer.state
    # Other draws would show: Adam's ten steps move a weight of r or h by 1e-2.
    for name in (n for n in parameters if n.startswith("reward.")):
        torch.testing.assert_close(parameters[name], others[name], rtol=0, atol=1e-4)
    lost, other = (m[0]["reward/loss_discriminator"] for m in (metrics, other_metrics))
    assert lost == pytest.approx(other, rel=1e-5)
