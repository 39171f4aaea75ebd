"""A task from outside of the package: one .py, one .xml, and one line."""

import gymnasium
import pytest
import torch

import pemirl_envs
from pemirl_envs import Component, tasks
from pemirl_envs.gym import gym_id

from .toy_task import Cart

SEED = 3


@pytest.fixture
def register():
    """``register_domain``, undone after the test."""
    registries = (tasks.DOMAINS, tasks.TASKS, gymnasium.registry)
    before = [dict(registry) for registry in registries]
    yield pemirl_envs.register_domain
    for registry, content in zip(registries, before, strict=True):
        registry.clear()
        registry.update(content)


def test_a_users_task_runs_on_every_face_and_they_agree(register):
    register("cart", {"normal": Cart})
    actions = torch.linspace(-1, 1, Cart.horizon)[:, None].numpy()

    batch = pemirl_envs.make("cart/normal", 1, seed=SEED)
    data, expected = batch.reset(), []
    for action in actions:
        data = batch.step(data.set("action", torch.from_numpy(action)[None]))["next"]
        expected.append((data["observation"][0].tolist(), data["reward"].item()))
        data = data.exclude("reward")
    assert data["truncated"].all()

    control, steps = pemirl_envs.load("cart", "normal", {"random": SEED}), []
    control.reset()
    for action in actions:
        step = control.step(action)
        steps.append((step.observation["observation"].tolist(), step.reward))
    assert steps == expected
    assert step.last()

    single, steps = gymnasium.make("pemirl_envs/CartNormal-v0"), []
    single.reset(seed=SEED)
    for action in actions:
        observation, reward, _, truncated, _ = single.step(action)
        steps.append((observation.tolist(), reward))
    assert steps == expected
    assert truncated

    vector, steps = gymnasium.make_vec("pemirl_envs/CartNormal-v0", 1), []
    vector.reset(seed=SEED)
    for action in actions[:-1]:
        observation, reward, *_ = vector.step(action[None])
        steps.append((observation[0].tolist(), reward.item()))
    assert steps == expected[:-1]


@pytest.mark.parametrize("domain", ["point_maze", "cart"])
def test_a_domain_that_is_taken_is_refused(register, domain):
    if domain == "cart":
        register("cart", {"normal": Cart})
    before = dict(pemirl_envs.TASKS)
    with pytest.raises(ValueError, match=f"the domain '{domain}' is taken; taken are point_maze"):
        register(domain, {"other": Cart})
    assert before == pemirl_envs.TASKS


@pytest.mark.parametrize(
    ("domain", "variant"), [("Cart", "normal"), ("cart/a", "b"), ("cart", "1st"), ("cart", "a__b")]
)
def test_malformed_names_are_refused(register, domain, variant):
    with pytest.raises(ValueError, match=r"malformed name '.*'; expected lower-case letters"):
        register(domain, {variant: Cart})
    assert f"{domain}/{variant}" not in pemirl_envs.TASKS


def test_what_makes_no_task_is_refused(register):
    with pytest.raises(ValueError, match="the domain 'cart' has no variants"):
        register("cart", {})
    with pytest.raises(
        TypeError, match=r"the variant cart/normal is .*Cart object.*; expected a fu"
    ):
        register("cart", {"normal": Cart()})
    assert "cart/normal" not in pemirl_envs.TASKS
    assert gym_id("cart/normal") not in gymnasium.registry


def test_two_tasks_do_not_share_an_id_of_gymnasium(register):
    with pytest.raises(ValueError, match="AntNormalRk4-v0 of 'ant_normal/rk4' is taken by 'ant/no"):
        register("ant_normal", {"rk4": Cart})
    assert "ant_normal/rk4" not in pemirl_envs.TASKS


def test_an_unknown_task_names_the_cure():
    with pytest.raises(
        ValueError, match=r"unknown task 'cart/normal'.*pemirl_envs.register_domain"
    ):
        pemirl_envs.make("cart/normal")


class Misnamed(Cart):
    observation_components = (Component("position", "m"),)


def test_an_observation_that_its_components_do_not_name_is_refused(register):
    register("cart", {"misnamed": Misnamed})
    message = r"Misnamed.observe gave 2 numbers; its observation_components name 1: \{'position': 1"
    with pytest.raises(ValueError, match=message):
        pemirl_envs.make("cart/misnamed").reset()
    with pytest.raises(ValueError, match=message):
        pemirl_envs.load("cart", "misnamed").reset()
    with pytest.raises(ValueError, match=message):
        gymnasium.make("pemirl_envs/CartMisnamed-v0").unwrapped.reset()


def test_what_a_task_does_not_define_is_refused_by_its_name():
    cart = Cart()
    observation, action = torch.zeros(4, 2), torch.zeros(4, 1)
    with pytest.raises(ValueError, match="Cart defines no observed_fields: its reward cannot be"):
        cart.state_reward(observation, action, {"aim": torch.zeros(4, 1)})
    with pytest.raises(ValueError, match="Cart is not a planar task"):
        cart.layout()
    assert cart.scripted_controller() is None
    assert dict(cart.outcomes) == {}
    assert cart.task_key == "aim"


class TwoParameters(Cart):
    def __init__(self):
        box = (torch.tensor([-1.0]), torch.tensor([1.0]))
        self.parameter_bounds = {"aim": box, "wind": box}


class TwoParametersOneKey(TwoParameters):
    task_key = "wind"


def test_the_task_key_of_several_parameters_must_be_named():
    with pytest.raises(ValueError, match=r"has the parameters \['aim', 'wind'\]; expected one, or"):
        _ = TwoParameters().task_key
    assert TwoParametersOneKey().task_key == "wind"
