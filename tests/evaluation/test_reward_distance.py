"""Small MDPs, where every expectation is a sum, and potentials whose cancelling is a theorem."""

import itertools

import pytest
import torch
from tensordict import TensorDict
from torch.nn.functional import one_hot

from pemirl_trl.evaluation import reward_distance
from pemirl_trl.evaluation.reward_distance import (
    canonicalise_epic,
    canonicalise_feasible,
    epic_distance,
    evaluate_reward,
    feasible_distance,
    independent_samples,
    pearson_distance,
    radial_basis,
    shaping_subspace,
    with_transitions,
)

STATES, ACTIONS, GAMMA = 5, 3, 0.9
pytestmark = pytest.mark.usefixtures("float64")


def transitions(s, a, following):
    """One-hot transitions ``[C, B]`` of integer tensors ``[C, B]``, with each task's number."""
    C, B = s.shape
    return TensorDict(
        {
            "observation": one_hot(s, STATES).double(),
            "action": one_hot(a, ACTIONS).double(),
            "next": {"observation": one_hot(following, STATES).double()},
            "task": {"number": torch.arange(C)[:, None, None].expand(C, B, 1)},
        },
        [C, B],
    )


def every_transition(C):
    """All triples (s, a, s'): as samples, their mean is the expectation under uniform marginals."""
    product = itertools.product(range(STATES), range(ACTIONS), range(STATES))
    return transitions(*torch.tensor(list(product)).T[:, None].expand(3, C, -1))


def tabular(table):
    """The reward function of tables ``[C, S, A, S]``, one per task."""

    def reward(batch):
        observation, action = batch["observation"], batch["action"]
        where = (v.argmax(-1) for v in (observation, action, batch["next", "observation"]))
        return table[(batch["task", "number"].squeeze(-1), *where)]

    return reward


def random_tables(C):
    return torch.randn(C, STATES, ACTIONS, STATES)


def equivalent(table):
    """Scaled, shifted and shaped by random potentials."""
    potential = 10 * torch.randn(len(table), STATES)
    shaping = GAMMA * potential[:, None, None, :] - potential[:, :, None, None]
    return 3 * table + shaping - 7


def dynamics_coverage(C, B=400):
    """Deterministic dynamics, random states and actions: s' is what the step leads to."""
    step = torch.randint(STATES, (C, STATES, ACTIONS))
    s, a = torch.randint(STATES, (C, B)), torch.randint(ACTIONS, (C, B))
    return transitions(s, a, step[torch.arange(C)[:, None], s, a])


def epic(first, second):
    batch = every_transition(len(first))
    return epic_distance(tabular(first), tabular(second), batch, batch, GAMMA)


def feasible(first, second, coverage=None):
    coverage = every_transition(len(first)) if coverage is None else coverage
    rewards = (evaluate_reward(tabular(table), coverage) for table in (first, second))
    observation, following = coverage["observation"], coverage["next", "observation"]
    return feasible_distance(*rewards, shaping_subspace(observation, following, GAMMA))


def close(value, expected, atol=1e-6):
    torch.testing.assert_close(value, torch.full_like(value, expected), rtol=0, atol=atol)


def test_epic_canonical_form_is_the_definition_summed_out():
    table = random_tables(4)
    batch = every_transition(4)
    got = canonicalise_epic(tabular(table), batch, batch, GAMMA).view_as(table)
    onward = table.mean((2, 3))  # E R(s, A, S')
    anywhere = table.mean((1, 2, 3), keepdim=True)
    expected = table + GAMMA * onward[:, None, None, :] - onward[:, :, None, None]
    torch.testing.assert_close(got, expected - GAMMA * anywhere)


def test_epic_does_not_depend_on_how_it_is_cut_into_chunks(monkeypatch):
    table, batch = random_tables(2), every_transition(2)
    whole = canonicalise_epic(tabular(table), batch, batch, GAMMA)
    monkeypatch.setattr(reward_distance, "_EVALUATIONS", 1000)  # chunks of 6 and a rest of 3
    torch.testing.assert_close(canonicalise_epic(tabular(table), batch, batch, GAMMA), whole)


@pytest.mark.parametrize("distance", [epic, feasible])
class TestDistance:
    """Laws of both distances; every row is an MDP of its own."""

    def test_is_0_for_equivalent_and_1_for_opposite_rewards(self, distance):
        table = random_tables(20)
        close(distance(table, equivalent(table)), 0)
        close(distance(table, -equivalent(table)), 1)

    def test_is_a_pseudometric(self, distance):
        x, y, z = random_tables(30), random_tables(30), random_tables(30)
        y[:15] = x[:15] + 0.1 * y[:15]  # near ones as well as unrelated ones
        xy, yz, xz = distance(x, y), distance(y, z), distance(x, z)
        torch.testing.assert_close(xy, distance(y, x))
        assert (xy[:15] > 0.01).all()
        assert (xy[:15] < 0.2).all()
        assert all(((d >= 0) & (d <= 1)).all() for d in (xy, yz, xz))
        assert (xz <= xy + yz + 1e-12).all()

    def test_of_unrelated_rewards_is_root_one_half_on_average(self, distance):
        # Over some 70 free values rho deviates by 0.12, a distance by 0.04, their mean by 0.003.
        mean = distance(random_tables(200), random_tables(200)).mean()
        assert mean.item() == pytest.approx(0.5**0.5, abs=0.012)

    def test_of_a_reward_that_prefers_nothing_is_undefined(self, distance):
        constant = torch.full_like(random_tables(2), 0.1)
        assert distance(constant, random_tables(2)).isnan().all()
        assert distance(random_tables(2), equivalent(constant)).isnan().all()


def test_sampled_epic_cancels_shaping_exactly_and_errs_elsewhere_by_its_samples():
    table, coverage = random_tables(10), every_transition(10)
    other, same = table + random_tables(10), equivalent(table)
    few, many = (independent_samples(coverage, n) for n in (4, 2000))
    close(epic_distance(tabular(table), tabular(same), coverage, few, GAMMA), 0)
    sampled = epic_distance(tabular(table), tabular(other), coverage, many, GAMMA)
    torch.testing.assert_close(sampled, epic(table, other), rtol=0, atol=0.01)


def test_samples_are_independent_and_stay_in_their_task():
    s = torch.arange(4).expand(2, 4)
    coverage = transitions(s, s % ACTIONS, s)
    coverage["observation"][1] = one_hot(torch.tensor(4), STATES).double()  # task 1 has one state
    samples = independent_samples(coverage, 6000)
    assert (samples["task", "number"].squeeze(-1) == torch.tensor([[0], [1]])).all()
    assert (samples["observation"][1].argmax(-1) == 4).all()
    s, following = (samples[k][0].argmax(-1) for k in ("observation", ("next", "observation")))
    joint = torch.bincount(4 * s + following, minlength=16) / 6000
    close(joint, 1 / 16, atol=0.015)


def test_feasible_distance_does_not_see_what_cannot_happen():
    """A reward that is arbitrary where the dynamics never lead: EPIC sees noise there."""
    coverage = dynamics_coverage(20)
    table = random_tables(20)
    happens = torch.zeros_like(table, dtype=torch.bool)
    s, a, following = (
        coverage[k].argmax(-1) for k in ("observation", "action", ("next", "observation"))
    )
    happens[torch.arange(20)[:, None], s, a, following] = True
    other = torch.where(happens, equivalent(table), 30 * random_tables(20))
    close(feasible(table, other, coverage), 0)
    samples = independent_samples(coverage, 100)
    wrong = epic_distance(tabular(table), tabular(other), coverage, samples, GAMMA)
    assert (wrong > 0.3).all()


def test_a_deterministic_policy_under_deterministic_dynamics_tells_nothing():
    """There minus the value is a potential that explains any reward."""
    s = torch.randint(STATES, (3, 100))
    a = s % ACTIONS
    coverage = transitions(s, a, (s + 1 + a) % STATES)
    assert feasible(random_tables(3), random_tables(3), coverage).isnan().all()


def test_canonical_form_is_the_shortest_shaped_copy_and_idempotent():
    coverage = dynamics_coverage(5)
    shaping = shaping_subspace(coverage["observation"], coverage["next", "observation"], GAMMA)
    table = random_tables(5)
    rewards = [evaluate_reward(tabular(t), coverage) for t in (table, equivalent(table) / 3)]
    form, again = (canonicalise_feasible(r, shaping) for r in rewards)
    torch.testing.assert_close(form, again)
    torch.testing.assert_close(canonicalise_feasible(form, shaping), form)
    assert all((form.norm(dim=-1) < r.norm(dim=-1)).all() for r in rewards)


def test_smooth_potentials_nearly_cancel_in_a_continuous_space():
    """The radial basis does not span a random network's potential, but comes close."""
    goals, weights = torch.rand(8, 1, 2), torch.randn(8, 2, 16)
    s = torch.rand(8, 600, 2)
    following = s + 0.05 * torch.randn(8, 600, 2)
    basis = radial_basis(s)
    shaping = shaping_subspace(basis(s), basis(following), GAMMA)

    def potential(states):
        return 3 * torch.tanh(2 * states @ weights).sum(-1)

    reward = -(s - goals).norm(dim=-1)
    shaped = 2 * reward + GAMMA * potential(following) - potential(s)
    assert (pearson_distance(reward, shaped) > 0.3).all()
    assert (feasible_distance(reward, shaped, shaping) < 0.05).all()
    other = -(s - goals.flip(0)).norm(dim=-1)  # another goal is another reward
    assert feasible_distance(reward, other, shaping).mean() > 0.2


def test_mistakes_are_explained():
    batch = every_transition(2)
    with pytest.raises(ValueError, match=r"75 transitions per task for 20 features.*at least 84"):
        shaping_subspace(torch.zeros(2, 75, 20), torch.zeros(2, 75, 20), GAMMA)
    with pytest.raises(ValueError, match=r"shape \[2, 75, 5\].*expected finite numbers \[2, 75\]"):
        evaluate_reward(lambda td: td["observation"], batch)
    with pytest.raises(ValueError, match="all finite: False"):
        evaluate_reward(lambda td: td["observation"][..., :1] / 0, batch)
    with pytest.raises(ValueError, match=r"batch size \[150\]; expected \[C, B\]"):
        evaluate_reward(tabular(random_tables(2)), batch.reshape(-1))


def test_other_transitions_keep_the_task_and_drop_what_was_measured():
    batch = every_transition(2)
    batch["next", "reward"] = torch.ones(2, 75, 1)
    parts = torch.zeros(2, 9, 5), torch.zeros(2, 9, 3), torch.ones(2, 9, 5)
    other = with_transitions(batch, *parts)
    assert other.batch_size == (2, 9)
    assert other["task", "number"].squeeze(-1).tolist() == [[0] * 9, [1] * 9]
    assert ("next", "reward") not in other.keys(True)
    assert (other["next", "observation"] == 1).all()
