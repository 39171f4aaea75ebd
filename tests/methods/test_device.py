"""The learner on a device, physics and every draw on the CPU: the same numbers, bit for bit.

There is no GPU here: ``pretend_device`` stands for one.
"""

from dataclasses import replace

import pytest
import torch

from pemirl_trl.checkpoint import TrainingCheckpoint
from pemirl_trl.methods import (
    BatchConfig,
    MetaIL,
    MetaILConfig,
    PolicyConfig,
    PolicyOptimization,
    PolicyOptimizationConfig,
    TRPOConfig,
)

from ..pretend_device import DEVICE, PretendDevice

# True of what "meta" commonly stands for; the pretended device does copy.
pytestmark = pytest.mark.filterwarnings("ignore:.*copying from a non-meta parameter:UserWarning")
JITTER = BatchConfig(trajectories=16, time_steps=5, jitter_fraction=0.5, jitter_scale=1.0)
MISMATCHED = BatchConfig(
    trajectories=16, time_steps=5, mismatched_fraction=0.5, relative_log_prob=True
)
METHODS = {
    "pemirl": lambda problem, model: problem.pemirl(model=model, encoder_lr=1e-3),
    "pemirl, blurred": lambda problem, model: problem.pemirl(
        model=model, batch=JITTER, gradient_penalty_coeff=0.1
    ),
    "pemirl, mismatched": lambda problem, model: problem.pemirl(model=model, batch=MISMATCHED),
    "pemirl, a forced deviation": lambda problem, model: problem.pemirl(
        model=model, policy=PolicyConfig(final_scale=0.3, final_imitation_coeff=1.0)
    ),
    "pemirl, of several lengths": lambda problem, model: cut(problem).pemirl(model=model),
    "airl": lambda problem, model: problem.airl(model=model),
    "meta_infogail": lambda problem, model: problem.meta_infogail(model=model),
    "meta_il": lambda problem, model: MetaIL(
        model, problem.demonstrations, MetaILConfig(steps=4, steps_per_iteration=2)
    ),
    "adaptation": lambda problem, model: adaptation(problem, model),
}
SIZES = {
    "pemirl, of several lengths": {"encoder": "attention"},
    "airl": {"encoder": "masked"},
    "meta_infogail": {"reward": "gail"},
}


def adaptation(problem, model):
    """Algorithm 2 with all that it may have."""
    config = PolicyOptimizationConfig(
        iterations=3,
        trpo=TRPOConfig(standardize="context"),
        final_scale=0.3,
        imitate_best=1.0,
        standardize_observations=True,
    )
    env = problem.env(model, 4, 2)
    return PolicyOptimization(
        env, model.policy, problem.horizon, config, rollouts_per_context=2, reward=model.reward
    )


def cut(problem):
    """Demonstrations of 6 to 10 steps."""
    pile = problem.demonstrations.clone()
    length = 6 + torch.arange(len(pile)) % 5
    pile["mask"] = torch.arange(problem.horizon) < length.unsqueeze(-1)
    return replace(problem, demonstrations=pile)


def made(name, problem, device="cpu"):
    return METHODS[name](problem, problem.model(**SIZES.get(name, {})).to(device))


def run(method, iterations):
    return [method.iteration() for _ in range(iterations)]


@pytest.mark.parametrize("name", METHODS)
def test_on_a_device_a_method_does_what_it_does_on_the_cpu(name, reach, state, differences):
    torch.manual_seed(1)
    here = made(name, reach)
    expected = run(here, 2)
    with PretendDevice():
        torch.manual_seed(1)
        there = made(name, reach, DEVICE)
        assert run(there, 2) == expected
        moved = {k: v.cpu() if isinstance(v, torch.Tensor) else v for k, v in state(there).items()}
    assert differences(state(here), moved) == []


@pytest.mark.parametrize("name", METHODS)
def test_a_run_begun_on_a_device_goes_on_anywhere(name, reach, state, differences, tmp_path):
    torch.manual_seed(1)
    whole = made(name, reach)
    run(whole, 1)
    checkpoint = TrainingCheckpoint(tmp_path)
    checkpoint.save(whole.components(), 1)
    expected = run(whole, 1)
    with PretendDevice():
        there = made(name, reach, DEVICE)
        checkpoint.load_latest(there.components())
        assert run(there, 1) == expected
