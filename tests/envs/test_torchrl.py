import pytest
import torch
from torchrl.collectors import Collector
from torchrl.envs import RewardSum, StepCounter, TransformedEnv

import pemirl_envs
from pemirl_envs import SimulationError


def make(num_envs=4, name="point_maze/left", **kwargs):
    return pemirl_envs.make(name, num_envs, **{"seed": 0, "num_threads": 1} | kwargs)


def test_a_collector_gets_whole_episodes_with_a_new_task_each():
    env = make(3, split="continuous")
    collector = Collector(
        env,
        random_policy,
        frames_per_batch=3 * 100,
        total_frames=3 * 100 * 2,
        auto_register_policy_transforms=False,
    )
    batches = list(collector)
    assert [batch.shape for batch in batches] == [(3, 100)] * 2
    goals = torch.stack([batch["task", "goal"] for batch in batches])  # [2, N, T, 2]
    assert (goals == goals[:, :, :1]).all()
    assert not (goals[0] == goals[1]).all(-1).any()
    for batch in batches:
        assert batch["next", "done"].sum().item() == 3
        following = batch["next", "observation"][:, :-1]
        assert torch.equal(batch["observation"][:, 1:], following)


def random_policy(tensordict):
    return tensordict.set("action", torch.randn(*tensordict.shape, 2))


def test_partial_resets_take_given_tasks_where_the_mask_says():
    env = make()
    data = env.rollout(5, break_when_any_done=False)[:, -1]["next"].exclude("reward")
    before = data.clone()
    mask = torch.tensor([[False], [True], [False], [True]])
    data.set("_reset", mask).set(("task", "goal"), torch.tensor([0.25, 0.5]).expand(4, 2))
    after = env.reset(data)
    rows = mask[:, 0]
    assert torch.equal(after["observation"][~rows], before["observation"][~rows])
    assert (after["observation"][rows] - torch.tensor([0.3, 0.0])).abs().max() <= 0.05
    # For rows that are not reset, TorchRL's reset returns its input; the environment knows better.
    goals = env.step(after.set("action", torch.zeros(4, 2)))["next", "task", "goal"]
    assert (goals[rows] == torch.tensor([0.25, 0.5])).all()
    assert torch.equal(goals[~rows], before["task", "goal"][~rows])


def test_what_is_returned_is_never_changed_later():
    env = make()
    data = env.reset()
    kept = [data.clone()]
    seen = [data]
    for step in range(3):
        following = env.step(seen[-1].clone().set("action", torch.ones(4, 2)))["next"]
        seen.append(following)
        kept.append(following.clone())
        following["task", "goal"].clone()
        env.reset(following.exclude("reward").set("_reset", torch.eye(4).bool()[step][:, None]))
    for a, b in zip(seen, kept, strict=True):
        assert (a.exclude("_reset") == b).all()


def test_editing_what_is_returned_does_not_reach_the_environment():
    env, twin = make(), make()
    data, clean = env.reset(), twin.reset()
    for key in ("observation", ("task", "goal"), "done", "truncated"):
        data.get(key).fill_(1)
    action = torch.zeros(4, 2)
    expected = twin.step(clean.set("action", action))["next"]
    assert (env.step(data.set("action", action))["next"] == expected).all()


def test_the_random_state_resumes_exactly():
    env = make(name="point_maze/stochastic")
    env.rollout(3)
    state = env.get_rng_state()
    expected = env.reset(), env.rand_step(env.reset())["next", "observation"]
    env.set_rng_state(state)
    first = env.reset()
    assert (first == expected[0]).all()
    other = make(name="point_maze/stochastic", seed=5)
    other.set_rng_state(state)
    assert (other.reset() == first).all()


def test_a_failed_step_keeps_the_others_and_goes_on_after_a_masked_reset():
    env, twin = make(), make()
    data, expected = env.reset(), twin.reset()
    action = torch.full((4, 2), 0.5)
    expected = twin.step(expected.set("action", action.clone()))["next"]
    action[2] = torch.nan
    with pytest.raises(SimulationError, match="2: the action is not finite") as caught:
        env.step(data.set("action", action))
    partial, healthy = caught.value.partial, torch.tensor([True, True, False, True])
    assert caught.value.indices.tolist() == [2]
    assert (partial[healthy] == expected[healthy]).all()
    assert torch.equal(partial["observation"][2], data["observation"][2])
    assert partial["reward"][2].isnan().all()
    assert not partial["done"][2]

    failed = torch.zeros(env.batch_size, dtype=torch.bool)
    failed[caught.value.indices] = True
    data = env.reset(partial.exclude("reward").set("_reset", failed[:, None]))
    action = torch.full((4, 2), -0.5)
    following = env.step(data.set("action", action))["next"]
    expected = twin.step(expected.exclude("reward").set("action", action))["next"]
    assert (following[healthy] == expected[healthy]).all()
    assert torch.isfinite(following["reward"]).all()


def test_a_diverging_simulation_is_named():
    env = make()
    data = env.reset()
    env.episodes.simulation.write({"qvel": torch.full((4, 2), 1e12)}, torch.arange(4) == 1)
    with pytest.raises(SimulationError, match=r"1: MuJoCo warned of BADQ") as caught:
        env.step(data.set("action", torch.zeros(4, 2)))
    assert caught.value.indices.tolist() == [1]
    assert torch.isfinite(caught.value.partial["reward"]).sum().item() == 3


def test_transforms_wrap_it_and_reach_its_methods():
    env = TransformedEnv(make(), StepCounter())
    assert env.rollout(3)["next", "step_count"].max() == 3
    assert env.get_rng_state().dtype == torch.uint8


def test_unknown_names_are_refused():
    with pytest.raises(ValueError, match="unknown task 'point_maze/up'; expected one of"):
        pemirl_envs.make("point_maze/up")
    with pytest.raises(ValueError, match="unknown split 'dev'; expected one of"):
        make(split="dev")
    with pytest.raises(ValueError, match="num_sims >= 1"):
        make(0)


def test_given_tasks_pass_through_a_transformed_env():
    """It strips a reset's tensordict, but hands keywords on."""
    goals = torch.tensor([[0.1, 0.5], [0.2, 0.5]])
    env = TransformedEnv(pemirl_envs.make("point_maze/left", 2, seed=0), RewardSum())
    assert torch.equal(env.reset(task={"goal": goals})["task", "goal"], goals)
    with pytest.raises(ValueError, match="goal"):
        env.reset(task={"goal": goals + 9.0})
