"""Adversarial IRL is PEMIRL less the information term; without contexts it sees the state alone."""

import torch


def after(method, iterations=2):
    torch.manual_seed(3)
    metrics = [method.iteration() for _ in range(iterations)]
    return metrics, method


def test_it_is_pemirl_without_the_information_term(reach, state, differences):
    """Bit for bit, once PEMIRL's draw of contexts for L_info is taken out of the random stream."""
    pemirl = reach.pemirl(info_coeff=0.0, encoder_lr=0.0, gradient_penalty_coeff=0.1)
    draw = pemirl._rows_of_some_contexts

    def aside(rollouts):
        with torch.random.fork_rng(devices=[]):
            return draw(rollouts)

    pemirl._rows_of_some_contexts = aside
    (expected, pemirl), (metrics, airl) = (
        after(pemirl),
        after(reach.airl(gradient_penalty_coeff=0.1)),
    )
    assert [m.keys() - expected[0].keys() for m in metrics] == [set(), set()]
    assert metrics == [{k: e[k] for k in m} for e, m in zip(expected, metrics, strict=True)]
    theirs = {k: v for k, v in state(pemirl).items() if not k.startswith("encoder_optimizer")}
    assert differences(state(airl), theirs) == []


def test_without_contexts_no_network_has_a_context(reach):
    model = reach.model(context_dim=0)
    _, method = after(reach.airl(model=model), 1)
    stored = method.sampler.negatives.state_dict()
    assert stored["context"].shape == (1, 8, reach.horizon, 0)
    for net in (model.policy.gaussian.net, model.reward.reward_net, model.reward.potential_net):
        assert net[0].in_features == 1  # the state's one dimension


def test_it_counts_environment_steps(reach):
    _, method = after(reach.airl(reward_steps=1), 3)
    assert method.env_steps == 3 * 4 * 2 * reach.horizon
