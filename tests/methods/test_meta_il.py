"""Meta-IL on the toy: it needs no environment, and it learns to imitate."""

import pytest
import torch

from pemirl_trl.checkpoint import TrainingCheckpoint
from pemirl_trl.methods import MetaIL, MetaILConfig, train


@pytest.mark.parametrize("sizes", [{}, {"encoder": "attention"}])
@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_it_infers_the_goal_and_imitates(reach, share, sizes):
    model = reach.model(**sizes)
    config = MetaILConfig(
        steps=300, steps_per_iteration=100, lr=3e-3, kl_coeff=0.01, part_share=share
    )
    method = MetaIL(model, reach.demonstrations, config)
    history = [method.iteration() for _ in range(method.iterations)]
    gain = 0.5 if share < 1 else 0.2  # where a start is not shown, its direction is not known
    assert history[-1]["meta_il/loss_imitation"] < history[0]["meta_il/loss_imitation"] - gain

    context = model.encoder.get_dist(reach.demonstrations).mean.detach()
    step = torch.zeros(len(context), 1)
    action = model.policy.gaussian.net(model.policy.gaussian.standardize(step), context)
    goal = reach.tasks["goal"]  # never shown
    assert torch.corrcoef(torch.cat([action, goal], 1).T)[0, 1] > (0.9 if share < 1 else 0.75)


def test_a_strong_prior_pulls_the_posterior_to_it(reach):
    def kl(coefficient):
        torch.manual_seed(0)
        config = MetaILConfig(steps=200, steps_per_iteration=100, lr=3e-3, kl_coeff=coefficient)
        method = MetaIL(reach.model(), reach.demonstrations, config)
        return [method.iteration() for _ in range(2)][-1]["meta_il/kl"]

    assert kl(10.0) < 0.1 < kl(0.001)


def test_the_reward_is_left_alone(reach):
    model = reach.model()
    before = {n: v.clone() for n, v in model.reward.state_dict().items()}
    MetaIL(model, reach.demonstrations, MetaILConfig(steps=2, steps_per_iteration=2)).iteration()
    assert all(torch.equal(v, before[n]) for n, v in model.reward.state_dict().items())


def test_metrics_are_means_over_the_steps(reach):
    def metrics(steps):
        torch.manual_seed(5)
        model = reach.model()
        torch.manual_seed(5)
        config = MetaILConfig(steps=4, steps_per_iteration=steps, lr=0.0)
        method = MetaIL(model, reach.demonstrations, config)
        return [method.iteration()["meta_il/loss_imitation"] for _ in range(method.iterations)]

    assert metrics(4)[0] == pytest.approx(sum(metrics(1)) / 4, rel=1e-6)


def test_the_rate_falls_along_half_a_cosine_and_a_resumed_run_goes_on_where_it_was(reach, tmp_path):
    config = MetaILConfig(
        steps=40, steps_per_iteration=10, lr=2e-3, lr_schedule="cosine", part_share=0.5
    )

    def method():
        torch.manual_seed(0)
        return MetaIL(reach.model(), reach.demonstrations, config)

    whole = method()
    train(whole)
    assert whole.optimizer.param_groups[0]["lr"] == pytest.approx(0.0, abs=1e-9)

    interrupted = method()
    interrupted.iterations = 2
    train(interrupted, checkpoint=TrainingCheckpoint(tmp_path))
    assert interrupted.optimizer.param_groups[0]["lr"] == pytest.approx(1e-3)
    resumed = method()
    train(resumed, checkpoint=TrainingCheckpoint(tmp_path))
    for name, weight in whole.model.state_dict().items():
        assert torch.equal(weight, resumed.model.state_dict()[name]), name
