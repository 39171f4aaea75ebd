"""Adaptation in one call: the start is chosen, the result never worse, doubts are said."""

import copy
from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict

from pemirl_trl import adapt, infer, load_policy
from pemirl_trl.evaluation import whole_episodes
from pemirl_trl.methods import AdaptationConfig, objective, policy_training

QUICK = {"rollouts": 24, "optimization": {"iterations": 18}}


@pytest.fixture
def new(dataset):
    return dataset(torch.tensor([[-0.7], [0.1], [0.65]]))


def end(policy, model, new, env):
    """Where episodes of a policy's mean action end."""
    with torch.no_grad():
        context = torch.stack([infer(model, new[i]).context for i in range(len(new))])

    def act(td):
        return policy(td.set("context", context))

    return whole_episodes(env, act, 10)["next", "observation"][:, -1, 0]


def test_a_policy_for_reversed_steering_is_found_and_earns_more(trained, new, make_reversed):
    result = adapt(trained, new, make_reversed, **QUICK)
    assert result.kept == "adapted"
    assert result.learned_return > result.carried_over_return
    goals = torch.tensor([-0.7, 0.1, 0.65])
    reached = end(result.policy, trained, new, make_reversed(3, 0))
    carried = end(trained.policy, trained, new, make_reversed(3, 0))
    assert (reached - goals).abs().mean() < 0.35 < (carried - goals).abs().mean()
    assert len(result.history) == 18
    assert result.env_steps == (18 + 4 * 3) * 24 * 10
    assert not any("return/true" in metrics for metrics in result.history)


WAYS = {"fresh-wide", "trained-wide", "fresh-narrow", "trained-narrow"}


def test_the_way_is_what_earns_most_in_a_short_try(trained, new, make_env, make_reversed):
    for make in (make_env, make_reversed):
        result = adapt(trained, new, make, **QUICK)
        assert set(result.tries) == WAYS
        best = max(result.tries, key=result.tries.get)
        assert f"{result.start}-{result.exploration}" == best
        assert f"start: {result.start}, exploration: {result.exploration}" in str(result)
    # Where nothing has changed, three iterations from anew are no match for what is there.
    assert adapt(trained, new, make_env, **QUICK).start == "trained"


@pytest.mark.parametrize(
    ("given", "tried"),
    [
        ({"initial_policy": "fresh"}, {"fresh-wide", "fresh-narrow"}),
        ({"exploration": "narrow"}, {"fresh-narrow", "trained-narrow"}),
        ({"initial_policy": "trained", "exploration": "wide"}, set()),
    ],
)
def test_what_is_given_is_not_tried_otherwise(trained, new, make_env, given, tried):
    seen = []
    result = adapt(
        trained,
        new,
        make_env,
        on_iteration=lambda stage, *rest: seen.append(stage),
        **given,
        **QUICK,
    )
    assert set(result.tries) == tried
    assert set(seen) == {f"try-{name}" for name in tried} | {"adaptation"}
    assert result.start == given.get("initial_policy", result.start)
    assert result.exploration == given.get("exploration", result.exploration)


def test_an_unknown_exploration_is_refused_with_the_choices(trained, new, make_env):
    with pytest.raises(
        ValueError, match=r"exploration 'broad'; choose one of \['wide', 'narrow'\]"
    ):
        adapt(trained, new, make_env, exploration="broad", **QUICK)


def test_what_earns_less_than_the_policy_carried_over_is_not_returned(trained, new, make_env):
    """A deviation that drowns everything, and one iteration: the fresh policy is no good."""
    settings = {"initial_policy": "fresh", "rollouts": 12, "optimization": {"iterations": 1}}
    result = adapt(trained, new, make_env, **settings)
    assert result.kept == "carried over"
    assert result.learned_return == result.carried_over_return
    assert any("the latter is returned" in text for text in result.warnings)
    env = make_env(3, 0)
    torch.manual_seed(1)
    kept = end(result.policy, trained, new, env)
    torch.manual_seed(1)
    torch.testing.assert_close(kept, end(trained.policy, trained, new, env))


def test_a_policy_that_acts_much_harder_than_was_demonstrated_is_said(trained, new, make_env):
    """Of actions as the environment clamps them; half of a size is a quarter of its square."""

    def said(demonstrations):
        episodes = policy_training.Episodes(make_env, trained, demonstrations, 0)
        training = policy_training.PolicyTraining(
            *(trained, demonstrations, episodes, lambda *stage: None), AdaptationConfig(), 0
        )
        return training.doubts(trained.policy)

    assert said(new) == []
    gentle = copy.deepcopy(new)
    gentle.action[:] = 0.5 * new.action.clamp(-1, 1)
    (warning,) = said(gentle)
    ratio = float(warning.split(" times")[0].split()[-1])
    assert 2.5 < ratio < 6
    # Padding, in which nobody acts, makes nobody gentle: constant actions, half of them recorded.
    constant = replace(new, action=torch.ones_like(new.action))
    cut = torch.full((len(new),), 5)
    padded = replace(constant, length=cut, terminated=torch.zeros(len(new), dtype=torch.bool))
    padded.action[:, 5:] = 0.0
    episodes = policy_training.Episodes(make_env, trained, new, 0)
    training = policy_training.PolicyTraining(
        *(trained, new, episodes, lambda *stage: None), AdaptationConfig(), 0
    )
    training.doubts(trained.policy)  # looks at the environment's actions
    training.demonstrations = padded
    acting = TensorDict({"action": torch.ones(4, 10, 1)}, [4, 10])
    assert training.hard_actions(acting) == []


def test_policies_are_compared_in_the_same_episodes(trained, new, make_env):
    episodes = policy_training.Episodes(make_env, trained, new, 0)
    training = policy_training.PolicyTraining(
        *(trained, new, episodes, lambda *stage: None), AdaptationConfig(), 0
    )
    assert training.learned_return(trained.policy) == training.learned_return(trained.policy)
    state = torch.get_rng_state()
    training.learned_return(trained.policy)
    assert torch.equal(torch.get_rng_state(), state)


def test_an_adaptation_is_that_of_its_seed(trained, new, make_reversed):
    runs = [adapt(trained, new, make_reversed, seed=seed, **QUICK) for seed in (0, 0, 1)]
    assert runs[0].learned_return == runs[1].learned_return != runs[2].learned_return


def test_states_far_from_training_are_said(trained, new, make_env):
    def distant(num_envs, seed):
        env = make_env(num_envs, seed)
        env.step_size = 25.0  # a step is twenty times the training range
        return env

    few = {"rollouts": 12, "optimization": {"iterations": 2}}
    result = adapt(trained, new, distant, **few)
    assert any("more than 3 training deviations" in text for text in result.warnings)
    assert result.warnings == tuple(str(result).split("warning: ", 1)[1].split("\nwarning: "))
    near = adapt(trained, new, make_env, **few).warnings
    assert not any("training deviations" in text for text in near)


def test_a_demonstration_far_from_training_is_said(trained, dataset, make_env):
    strange = dataset(torch.tensor([[0.2], [30.0]]))
    strange.observation[1] += 40.0
    few = {"rollouts": 8, "optimization": {"iterations": 1}}
    warnings = adapt(trained, strange, make_env, **few).warnings
    assert any(text.startswith("demonstration 1 is FAR from the training") for text in warnings)
    assert not any(text.startswith("demonstration 0") for text in warnings)


def test_a_model_of_an_unknown_family_is_said(trained, new, make_env):
    old = copy.deepcopy(trained)
    old.family = None
    few = {"rollouts": 12, "optimization": {"iterations": 1}}
    assert (
        "whether these demonstrations are of its family is unknown"
        in (adapt(old, new, make_env, **few).warnings[0])
    )


def test_a_model_whose_contexts_did_not_say_tasks_is_said(trained, new, make_env):
    assert trained.family.recovered > 0.85
    few = {"rollouts": 12, "optimization": {"iterations": 1}}
    doubtful = copy.deepcopy(trained)
    for share, said in ((0.3, True), (trained.family.recovered, False), (None, False)):
        doubtful.family = replace(trained.family, recovered=share, outdone=None, displaced=None)
        warnings = adapt(doubtful, new, make_env, **few).warnings
        assert any("(0.30 of a context is typically" in text for text in warnings) == said


def test_episodes_that_begin_far_from_the_demonstrations_are_said(trained, new, make_env, caplog):
    far = copy.deepcopy(new)
    far.observation[:, 0] = 50.0
    few = {"initial_policy": "fresh", "exploration": "wide"}
    few |= {"rollouts": 8, "optimization": {"iterations": 1}}
    for demonstrations, said in ((new, False), (far, True)):
        caplog.clear()
        adapt(trained, demonstrations, make_env, **few)
        assert ("deviations outside of where demonstrations did" in caplog.text) == said


def test_a_function_that_takes_no_seed_is_refused_in_words(trained, new, make_env):
    with pytest.raises(TypeError, match=r"it is called as make_env\(num_envs, seed\)"):
        adapt(trained, new, lambda num_envs: make_env(num_envs, 0))


def test_demonstrations_of_another_task_are_refused_before_anything(reach, new, make_env):
    model = reach.model()
    model.horizon = 12
    with pytest.raises(ValueError, match=r"\(S, A, T\) = \(1, 1, 10\).*trained on \(1, 1, 12\)"):
        adapt(model, new, make_env)


def test_a_saved_policy_acts_as_the_returned_one(trained, new, make_env, tmp_path):
    few = {"optimization": {"iterations": 1}, "rollouts": 8}
    adaptation = adapt(trained, new, make_env, initial_policy="fresh", exploration="wide", **few)
    adaptation.save(tmp_path / "policy.safetensors")
    policy = load_policy(tmp_path / "policy.safetensors", trained)
    inference, states = infer(trained, new[0]), torch.randn(5, trained.observation_dim)
    given = inference.action(states, adaptation.policy)
    assert torch.equal(inference.action(states, policy), given)


def test_the_policy_reads_observation_and_context(trained, new, make_env):
    few = {"rollouts": 12, "optimization": {"iterations": 1}}
    policy = adapt(trained, new, make_env, **few).policy
    batch = TensorDict({"observation": torch.zeros(2, 1), "context": torch.zeros(2, 2)}, [2])
    assert policy(batch)["action"].shape == (2, 1)


def test_a_cost_of_actions_makes_a_policy_that_acts_less(trained, new, make_reversed):
    free, dear = (
        adapt(trained, new, make_reversed, action_cost=cost, initial_policy="fresh", **QUICK)
        for cost in (0.0, 100.0)
    )
    batch = TensorDict({"observation": torch.zeros(3, 1)}, [3])
    with torch.no_grad():
        batch.set("context", torch.stack([infer(trained, new[i]).context for i in range(3)]))
        effort = [r.policy(batch.copy())["action"].abs().mean() for r in (free, dear)]
    assert effort[1] < 0.5 * effort[0]
    assert dear.carried_over_return < free.carried_over_return  # it pays as well


def test_the_cost_of_choices_is_refused(trained, new, make_env):
    model = copy.deepcopy(trained)
    model.config = replace(model.config, actions="discrete", policy_scale=0.5)
    env = make_env(2, 0)
    with pytest.raises(ValueError, match=r"action_cost is 0\.1, and the actions are choices"):
        objective(model, AdaptationConfig(action_cost=0.1), env)
