"""The average of the reward's weights: by hand, and without a trace in the training."""

import pytest
import torch

from pemirl_trl.methods import AveragedReward

ITERATIONS, DECAY = 4, 0.7


def test_the_model_ends_with_the_average_and_trains_as_without_it(reach, state, differences):
    plain = reach.pemirl(iterations=ITERATIONS, reward_steps=2)
    torch.manual_seed(3)
    snapshots, metrics = [], []
    for _ in range(ITERATIONS):
        metrics.append(plain.iteration())
        snapshots.append({k: v.clone() for k, v in plain.model.reward.state_dict().items()})

    model = reach.model()
    inner = reach.pemirl(model=model, iterations=ITERATIONS, reward_steps=2)
    method = AveragedReward(inner, model, DECAY)
    torch.manual_seed(3)
    assert [method.iteration() for _ in range(ITERATIONS)] == metrics
    assert method.env_steps == plain.env_steps > 0

    # It starts at the first snapshot; each later one counts 0.3.
    expected = snapshots[0]
    for snapshot in snapshots[1:]:
        expected = {k: DECAY * v + (1 - DECAY) * snapshot[k] for k, v in expected.items()}
    torch.testing.assert_close(dict(model.reward.state_dict()), expected)
    differ = differences(state(inner), state(plain))
    assert differ
    assert all(name.startswith("model.reward.") for name in differ)


def test_until_the_last_iteration_the_model_has_the_weights_that_train(reach, state, differences):
    plain, model = reach.pemirl(iterations=3, reward_steps=2), reach.model()
    inner = reach.pemirl(model=model, iterations=3, reward_steps=2)
    for method in (plain, AveragedReward(inner, model, DECAY)):
        torch.manual_seed(3)
        for _ in range(2):
            method.iteration()
    assert differences(state(inner), state(plain)) == []


@pytest.mark.parametrize("decay", [0.0, 1.0, 1.5, -0.1])
def test_a_decay_that_is_no_weight_is_refused(decay, reach):
    method = reach.airl()
    with pytest.raises(ValueError, match=f"decay is {decay}; expected a number between 0 and 1"):
        AveragedReward(method, method.model, decay)
