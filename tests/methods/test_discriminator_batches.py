"""Where each transition of a discriminator batch comes from, and with which m and log pi."""

import pytest
import torch
from tensordict import TensorDict
from torch.distributions import Normal

from pemirl_trl.data import Negatives
from pemirl_trl.methods import BatchConfig, DiscriminatorBatches

TRAJECTORIES, STEPS = 20, 5


def sides(batch):
    """A batch ``[2 n k]`` as its halves ``[n, k]``, the expert's and the policy's."""
    expert, policy = batch.unflatten(0, (2, TRAJECTORIES, STEPS)).unbind(0)
    assert expert["is_expert"].all()
    assert not policy["is_expert"].any()
    return expert, policy


def rollouts(value, count=6, horizon=10):
    """Random rollouts, all of log pi ``value``."""
    shape = (count, horizon)
    return TensorDict(
        {
            "observation": torch.randn(*shape, 1),
            "action": torch.randn(*shape, 1),
            "next": {"observation": torch.randn(*shape, 1)},
            "context": torch.randn(count, 1, 3).expand(*shape, 3).clone(),
            "action_log_prob": torch.full(shape, float(value)),
        },
        shape,
    )


@pytest.fixture
def negatives():
    """Four iterations, told apart by their log pi: 0, 1, 2, 3."""
    held = Negatives(capacity=4)
    for iteration in range(4):
        held.add(rollouts(iteration))
    return held


@pytest.fixture
def draw(reach, negatives):
    model = reach.model()

    def build(seed=0, last=4, **config):
        config = BatchConfig(trajectories=TRAJECTORIES, time_steps=STEPS, **config)
        batches = DiscriminatorBatches(model, reach.demonstrations, negatives, config)
        torch.manual_seed(seed)
        return model, batches.sample(last)

    return build


def rows_of(batch, *keys):
    return torch.cat([batch.get(k).flatten(0, 1) for k in keys], -1)


TRANSITION = ("observation", ("next", "observation"), "action")


def test_expert_transitions_are_the_demonstrations_own(draw, reach):
    expert, _ = sides(draw()[1])
    known = rows_of(reach.demonstrations, *TRANSITION)
    drawn = rows_of(expert, *TRANSITION)
    assert (drawn.unsqueeze(1) == known).all(-1).any(1).all()
    # k transitions of one demonstration, not of k.
    match = (drawn.unsqueeze(1) == known).all(-1).int().argmax(1) // reach.horizon
    assert (match.view(TRAJECTORIES, STEPS) == match[::STEPS, None]).all()
    assert len(match.unique()) > 6


def test_an_expert_transition_has_the_context_of_its_own_demonstration(draw, reach):
    model, _ = draw()
    with torch.no_grad():
        for name, parameter in model.encoder.named_parameters():
            if name.endswith("log_scale"):
                parameter.fill_(-30.0)  # q is its mean, then
    expert, _ = sides(draw()[1])
    known = rows_of(reach.demonstrations, *TRANSITION)
    match = (rows_of(expert, *TRANSITION).unsqueeze(1) == known).all(-1).int().argmax(1)
    mean = model.encoder.get_dist(reach.demonstrations).mean[match // reach.horizon]
    torch.testing.assert_close(expert["context"].flatten(0, 1), mean)


def test_an_expert_transition_has_the_density_of_the_current_policy(draw):
    model, batch = draw()
    expert, _ = sides(batch)
    gaussian = model.policy.gaussian
    loc = gaussian.net(gaussian.standardize(expert["observation"]), expert["context"])
    expected = Normal(loc, gaussian.log_scale.exp()).log_prob(expert["action"]).sum(-1)
    torch.testing.assert_close(expert["action_log_prob"], expected.detach())


def test_expert_contexts_are_drawn_by_reparameterisation(draw):
    model, batch = draw()
    expert, _ = sides(batch)
    gradient = torch.autograd.grad(expert["context"].sum(), model.encoder.parameters())
    assert all(g.abs().sum() > 0 for g in gradient)
    assert not batch["action_log_prob"].requires_grad
    assert not torch.equal(expert["context"], sides(draw(seed=1)[1])[0]["context"])


def test_policy_transitions_are_as_they_were_stored(draw, negatives):
    _, policy = sides(draw()[1])
    stored = negatives.state_dict()
    stored = TensorDict(stored, [4, 6, 10]).unflatten_keys(".").flatten(0, 1)
    keys = (*TRANSITION, "context")

    def rows(batch):
        return torch.cat([rows_of(batch, *keys), batch["action_log_prob"].reshape(-1, 1)], -1)

    assert (rows(policy).unsqueeze(1) == rows(stored)).all(-1).any(1).all()


def test_a_policy_transition_has_the_current_policys_density_where_it_is_told_to(draw):
    plain = sides(draw()[1])[1]
    model, batch = draw(negative_log_prob="current")
    _, policy = sides(batch)
    gaussian = model.policy.gaussian
    loc = gaussian.net(gaussian.standardize(policy["observation"]), policy["context"])
    expected = Normal(loc, gaussian.log_scale.exp()).log_prob(policy["action"]).sum(-1)
    torch.testing.assert_close(policy["action_log_prob"], expected.detach())
    assert not policy["action_log_prob"].requires_grad
    for key in (*TRANSITION, "context"):  # and nothing else is another
        assert torch.equal(policy.get(key), plain.get(key))


def test_an_unknown_density_is_refused():
    with pytest.raises(ValueError, match=r"negative_log_prob\n  Input should be 'collection' or"):
        BatchConfig(negative_log_prob="mixture")


@pytest.mark.parametrize(
    ("last", "fraction", "newest", "legal"),
    [(4, 1.0, 20, {3}), (2, 0.25, 5, {2, 3}), (4, 0.5, 10, {0, 1, 2, 3}), (1, 0.0, 20, {3})],
)
def test_fractions_are_counts(last, fraction, newest, legal, draw):
    _, policy = sides(draw(last=last, current_fraction=fraction)[1])
    iteration = policy["action_log_prob"][:, 0]
    assert (iteration[:newest] == 3).all()  # the newest iteration's come first
    assert set(iteration.unique().tolist()) == legal


def test_jitter_moves_both_observations_alike_and_nothing_else(draw):
    plain_expert, plain = sides(draw()[1])
    expert, jittered = sides(draw(jitter_fraction=1.0, jitter_scale=2.0)[1])
    shift = jittered["observation"] - plain["observation"]
    next_shift = jittered["next", "observation"] - plain["next", "observation"]
    torch.testing.assert_close(shift, next_shift, atol=1e-5, rtol=0)
    assert (shift != 0).all()
    for key in ("action", "context", "action_log_prob"):
        assert torch.equal(jittered[key], plain[key])
    for key in (*TRANSITION, "context", "action_log_prob"):
        assert torch.equal(expert.get(key), plain_expert.get(key))


def test_jitter_has_the_fraction_and_the_size_asked_for(reach, negatives):
    model = reach.model()
    n, fraction, scale = 4000, 0.3, 2.0

    def observations(**jitter):
        config = BatchConfig(trajectories=n, time_steps=1, **jitter)
        torch.manual_seed(0)
        batches = DiscriminatorBatches(model, reach.demonstrations, negatives, config)
        return batches.sample(4)["observation"][n:]

    noise = observations(jitter_fraction=fraction, jitter_scale=scale) - observations()
    moved = noise != 0
    assert float(moved.float().mean()) == pytest.approx(fraction, abs=0.03)  # 4 deviations
    # E s^2 with s ~ U(0, c) is c^2 / 3; in units of the demonstrations' deviation.
    unit = float(reach.demonstrations["observation"].std())
    assert float(noise[moved].square().mean()) == pytest.approx((scale * unit) ** 2 / 3, rel=0.15)


def test_mismatched_negatives_are_the_experts_under_the_context_of_another_demonstration(draw):
    plain_expert, _ = sides(draw()[1])
    model, batch = draw(mismatched_fraction=0.3)
    expert, negative = sides(batch)
    own, mismatched = negative[:14], negative[14:]
    for key in (*TRANSITION, "context", "action_log_prob"):
        assert torch.equal(expert.get(key), plain_expert.get(key))
    for key in (*TRANSITION, "action_log_prob"):  # the log pi under their own context
        assert torch.equal(mismatched.get(key), expert[:6].get(key))
    drawn = mismatched["context"][:, 0]
    source = (drawn.unsqueeze(1) == expert["context"][:, 0]).all(-1).int().argmax(1)
    assert (source != torch.arange(6)).sum() >= 4  # a permutation may leave one where it is
    assert torch.equal(mismatched["context"], expert["context"][source])
    encoder = list(model.encoder.parameters())
    for gradient in torch.autograd.grad(mismatched["context"].sum(), encoder):
        assert (gradient == 0).all()
    assert set(own["action_log_prob"].unique().tolist()) <= {0.0, 1.0, 2.0, 3.0}


def test_all_or_none_of_the_negatives_may_be_mismatched(draw):
    _, negative = sides(draw(mismatched_fraction=1.0)[1])
    assert len(negative) == TRAJECTORIES
    assert torch.equal(draw(mismatched_fraction=0.0)[1]["context"], draw()[1]["context"])
    with pytest.raises(ValueError, match=r"mismatched_fraction\n  Input should be less than or"):
        BatchConfig(mismatched_fraction=1.5)


def test_mismatched_negatives_need_contexts(reach, negatives):
    model = reach.model(context_dim=0)
    with pytest.raises(ValueError, match="no contexts to confuse; expected 0"):
        DiscriminatorBatches(
            model, reach.demonstrations, negatives, BatchConfig(mismatched_fraction=0.5)
        )


def test_log_pi_may_be_relative_to_the_policys_density_at_its_mean(draw):
    model, plain = draw(mismatched_fraction=0.3)
    relative = draw(mismatched_fraction=0.3, relative_log_prob=True)[1]
    scale = model.policy.log_scale.detach().exp()
    peak = Normal(torch.zeros_like(scale), scale).log_prob(torch.zeros_like(scale)).sum()
    torch.testing.assert_close(relative["action_log_prob"], plain["action_log_prob"] - peak)
    assert torch.equal(relative["observation"], plain["observation"])


def test_the_experts_m_is_of_what_is_shown_in_its_place(reach, negatives):
    """Steps are the demonstrations' own, contexts those of the others, draw by draw."""
    model, own = reach.model(), reach.demonstrations
    other = own.apply(torch.neg)
    config = BatchConfig(trajectories=TRAJECTORIES, time_steps=STEPS)

    def expert(demonstrations):
        torch.manual_seed(0)
        return sides(DiscriminatorBatches(model, demonstrations, negatives, config).sample(4))[0]

    paired = expert(own.clone().set("shown", other))
    assert torch.equal(paired["observation"], expert(own)["observation"])
    assert torch.equal(paired["context"], expert(other)["context"])
