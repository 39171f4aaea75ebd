"""What holds for every adversarial method: no label leaks, one optimiser per network, annealing."""

import pytest
import torch

from pemirl_trl.methods import EpisodeCollector, PolicyConfig, TRPOConfig

BUILD = {
    "pemirl": lambda problem, **c: problem.pemirl(reward_steps=2, **c),
    "airl": lambda problem, **c: problem.airl(
        model=problem.model(context_dim=0), reward_steps=2, **c
    ),
    "airl_with_contexts": lambda problem, **c: problem.airl(reward_steps=2, **c),
    "meta_infogail": lambda problem, **c: problem.meta_infogail(discriminator_steps=2, **c),
}
# Which networks a method moves, and the setting that holds each of them alone.
FREEZE = {
    "airl": {"reward": {"reward_lr": 0.0}},
    "airl_with_contexts": {"reward": {"reward_lr": 0.0}},
    "meta_infogail": {"reward": {"discriminator_lr": 0.0}, "encoder": {"encoder_lr": 0.0}},
}
STILL = PolicyConfig(trpo=TRPOConfig(max_kl=1e-30))

each_method = pytest.mark.parametrize("name", BUILD)


def weights(model):
    return {name: value.clone() for name, value in model.state_dict().items()}


def run(method, iterations=1):
    torch.manual_seed(3)
    metrics = [method.iteration() for _ in range(iterations)]
    return weights(method.model), metrics


@each_method
def test_permuted_task_labels_change_no_parameter(name, reach, differences):
    (parameters, metrics), (others, other_metrics) = (
        run(BUILD[name](reach, tasks=tasks), 2) for tasks in (reach.tasks, reach.tasks.roll(1, 0))
    )
    assert differences(parameters, others) == []
    # The labels did reach the environment, where they make the true return: a metric.
    for one, other in zip(metrics, other_metrics, strict=True):
        assert one.pop("return/true") != other.pop("return/true")
    assert metrics == other_metrics


@pytest.mark.parametrize(
    ("name", "frozen"),
    [(name, network) for name, held in FREEZE.items() for network in (None, "policy", *held)],
)
def test_each_network_has_one_optimiser(name, frozen, reach):
    settings = {"policy": STILL} if frozen == "policy" else FREEZE[name].get(frozen, {})
    method = BUILD[name](reach, **settings)
    before = weights(method.model)
    after, _ = run(method)
    moved = {
        key.split(".")[0] for key, value in after.items() if not torch.equal(value, before[key])
    }
    assert moved == {"policy", *FREEZE[name]} - {frozen}


@pytest.fixture
def scales(monkeypatch):
    """The policy's deviation in each collection, as the rollouts tell it."""
    seen, collect = [], EpisodeCollector.__call__

    def spy(collector):
        rollouts = collect(collector)
        (scale,) = rollouts["scale"].unique().tolist()
        seen.append(scale)
        return rollouts

    monkeypatch.setattr(EpisodeCollector, "__call__", spy)
    return seen


@each_method
def test_deviation_and_imitation_weight_are_annealed_before_collection(name, reach, scales):
    policy = PolicyConfig(final_imitation_coeff=1.0, final_scale=0.25, anneal_begin=0.5)
    method = BUILD[name](reach, iterations=5, policy=policy)
    mean = [p.clone() for p in method.model.policy.gaussian.net.parameters()]
    torch.manual_seed(3)
    coefficients, after = [], []
    for _ in range(5):
        after.append(method.iteration()["policy/scale"])
        coefficients.append(method.sampler.imitation_coeff)
    # The five iterations stand at 0, 1/4, 1/2, 3/4 and 1.
    assert scales == pytest.approx([1.0, 1.0, 1.0, 0.5, 0.25])
    assert after == pytest.approx(scales)  # the policy's step leaves it alone
    assert coefficients == pytest.approx([0.01, 0.01, 0.01, 0.1, 1.0])
    now = method.model.policy.gaussian.net.parameters()
    assert any(not torch.equal(a, b) for a, b in zip(mean, now, strict=True))


def test_without_final_values_nothing_is_annealed(reach, scales):
    method = reach.airl(iterations=3, reward_steps=1)
    torch.manual_seed(3)
    for _ in range(3):
        method.iteration()
        assert method.sampler.imitation_coeff == 0.01
    assert scales[0] == 1.0
    assert len(set(scales)) == 3  # the deviation is the policy's own, and learned
