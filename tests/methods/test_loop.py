"""Training survives: a resumed run repeats an uninterrupted one; what diverges is not saved."""

import contextlib
import copy
import math
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch

from pemirl_trl.checkpoint import TrainingCheckpoint, UnusableCheckpointWarning
from pemirl_trl.methods import (
    AveragedReward,
    MetaIL,
    MetaILConfig,
    PolicyConfig,
    TrainingDiverged,
    train,
)

ITERATIONS = 6


def meta_il(problem, seed):
    config = MetaILConfig(steps=2 * ITERATIONS, steps_per_iteration=2, batch_size=8)
    return MetaIL(problem.model(seed), problem.demonstrations, config)


def pemirl(problem, seed):
    # Fewer iterations are replayed than run: the ring of negatives turns over.
    config = {"replay_iterations": 3, "gradient_penalty_coeff": 0.01}
    return problem.pemirl(seed, iterations=ITERATIONS, **config)


def annealed_pemirl(problem, seed):
    policy = PolicyConfig(final_imitation_coeff=1.0, final_scale=0.3)
    config = {"iterations": ITERATIONS, "reward_steps": 2, "final_reward_lr": 1e-5}
    return problem.pemirl(seed, policy=policy, **config)


def averaged(problem, seed):
    model = problem.model(seed)
    method = problem.pemirl(model=model, iterations=ITERATIONS, reward_steps=2)
    return AveragedReward(method, model, decay=0.7)


def airl(problem, seed):
    model = problem.model(seed, context_dim=0)
    return problem.airl(model=model, iterations=ITERATIONS, reward_steps=2)


def meta_infogail(problem, seed):
    return problem.meta_infogail(seed, iterations=ITERATIONS, discriminator_steps=2)


def true_reward(problem, seed):
    return problem.policy_optimization(seed, iterations=ITERATIONS)


def learned_reward(problem, seed):
    return problem.policy_optimization(seed, learned=True, iterations=ITERATIONS)


def annealed(problem, seed):
    return problem.policy_optimization(seed, iterations=ITERATIONS, final_scale=0.1)


class KilledError(Exception):
    """The end of a process, inside this one."""


def run(method, seed, folder, until=None):
    """Train with a checkpoint every second iteration; return the metrics of each iteration."""
    torch.manual_seed(seed)
    history = {}

    def record(iteration, metrics):
        history[iteration] = metrics
        if iteration == until:
            raise KilledError

    with contextlib.suppress(KilledError):
        checkpoint = TrainingCheckpoint(folder)
        train(method, checkpoint=checkpoint, checkpoint_every=2, on_iteration=record)
    return history


RESUMED = [
    meta_il,
    pemirl,
    annealed_pemirl,
    averaged,
    airl,
    meta_infogail,
    true_reward,
    learned_reward,
    annealed,
]


@pytest.mark.parametrize("build", RESUMED)
def test_a_resumed_run_is_bit_identical(build, reach, state, differences, tmp_path):
    straight = build(reach, 1)
    expected = run(straight, 10, tmp_path / "straight")
    run(build(reach, 1), 10, tmp_path / "resumed", until=5)

    resumed = build(reach, 2)
    assert differences(state(resumed), state(straight))  # it starts elsewhere
    history = run(resumed, 20, tmp_path / "resumed")
    assert list(history) == [5, 6]
    assert history == {i: expected[i] for i in history}
    assert differences(state(resumed), state(straight)) == []
    assert resumed.env_steps == straight.env_steps


def test_a_finished_run_does_nothing_more(reach, state, differences, tmp_path):
    done = meta_il(reach, 1)
    run(done, 1, tmp_path)
    loaded = meta_il(reach, 2)
    assert run(loaded, 2, tmp_path) == {}
    assert differences(state(loaded), state(done)) == []


PROCESS = """
import sys
import torch
from conftest import maze_problem
from pemirl_trl.checkpoint import TrainingCheckpoint
from pemirl_trl.methods import train
torch.set_num_threads(1)
method = maze_problem().pemirl(1, iterations=4)
torch.manual_seed(10)
train(method, checkpoint=TrainingCheckpoint(sys.argv[1]), checkpoint_every=1)
"""


def start(folder):
    path = os.pathsep.join([str(Path(__file__).parent), *filter(None, sys.path)])
    return subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", PROCESS, str(folder)],
        env={**os.environ, "PYTHONPATH": path},
        stderr=subprocess.PIPE,
    )


def test_a_killed_process_is_resumed_by_another(maze, state, differences, tmp_path):
    folder = tmp_path / "run"
    with start(folder) as process:
        while not list(folder.glob("checkpoint-*2")) and process.poll() is None:
            time.sleep(0.005)
        process.kill()
        _, errors = process.communicate()
    assert process.returncode == -signal.SIGKILL, errors.decode()
    with start(folder) as process:
        _, errors = process.communicate()
    assert process.returncode == 0, errors.decode()

    straight, resumed = maze.pemirl(1, iterations=4), maze.pemirl(2)
    torch.manual_seed(10)
    train(straight)
    assert TrainingCheckpoint(folder).load_latest(resumed.components()) == 4
    assert differences(state(resumed), state(straight)) == []


def nan_weight(method):
    with torch.no_grad():
        method.model.policy.log_scale[0] = math.nan


def huge_weight(method):
    with torch.no_grad():
        method.model.policy.log_scale[0] = -1e12


def huge_actions(method):
    method.demonstrations["action"] = 1e12 * method.demonstrations["action"]


def nan_reward(method):
    with torch.no_grad():
        next(method.model.reward.parameters()).fill_(math.nan)


@pytest.mark.parametrize(
    ("build", "sabotage", "planted_after", "quantity"),
    [
        (meta_il, nan_weight, True, "policy."),
        (meta_il, huge_weight, True, "policy."),
        (meta_il, huge_actions, False, "meta_il/loss_imitation"),
        (pemirl, nan_reward, False, "reward/loss_info_reward"),
        (pemirl, nan_weight, True, "model.policy."),
    ],
)
def test_divergence_is_named_and_never_saved(
    build, sabotage, planted_after, quantity, reach, state, differences, tmp_path
):
    method = build(copy.deepcopy(reach), 1)
    healthy, states = method.iteration, {}

    def iteration():
        current = len(states) + 1
        if current == 4 and not planted_after:
            sabotage(method)
        metrics = healthy()
        if current == 4 and planted_after:
            sabotage(method)
        states[current] = state(method)
        return metrics

    method.iteration = iteration
    checkpoint = TrainingCheckpoint(tmp_path)
    with pytest.raises(TrainingDiverged, match=r"in iteration 4\. .* iteration 3\.") as raised:
        train(method, checkpoint=checkpoint, checkpoint_every=1)
    assert raised.value.quantity.startswith(quantity)
    assert raised.value.iteration == 4
    assert raised.value.quantity in str(raised.value)

    restored = build(reach, 2)
    assert checkpoint.load_latest(restored.components()) == 3
    assert differences(state(restored), states[3]) == []


def adam_state(method):
    first = next(iter(method.optimizer.state.values()))
    first["exp_avg"].view(-1)[0] = math.inf


def buffer(method):
    method.model.standardize.loc[0] = math.nan


@pytest.mark.parametrize(
    ("build", "sabotage", "quantity", "value"),
    [
        (meta_il, adam_state, "optimizer.state.0.exp_avg", math.inf),
        (pemirl, buffer, "model.standardize.loc", math.nan),
    ],
)
def test_no_state_that_is_not_finite_is_saved(build, sabotage, quantity, value, reach, tmp_path):
    method = build(copy.deepcopy(reach), 1)
    healthy, count = method.iteration, 0

    def iteration():
        nonlocal count
        count += 1
        metrics = healthy()
        if count == 4:
            sabotage(method)
        return metrics

    method.iteration = iteration
    checkpoint = TrainingCheckpoint(tmp_path)
    with pytest.raises(TrainingDiverged, match=r"in iteration 4\. .* iteration 2\.") as raised:
        train(method, checkpoint=checkpoint, checkpoint_every=2)
    assert raised.value.quantity == quantity
    assert str(raised.value.value) == str(value)
    assert checkpoint.load_latest(build(reach, 2).components()) == 2


def test_a_damaged_checkpoint_costs_the_iterations_since_the_one_before(
    reach, state, differences, tmp_path
):
    straight = meta_il(reach, 1)
    expected = run(straight, 10, tmp_path)
    (tmp_path / "checkpoint-000000000006" / "manifest.json").write_text("")
    resumed = meta_il(reach, 2)
    with pytest.warns(UnusableCheckpointWarning, match="continued from checkpoint-000000000004"):
        history = run(resumed, 20, tmp_path)
    assert history == {i: expected[i] for i in (5, 6)}
    assert differences(state(resumed), state(straight)) == []


def test_a_checkpoint_of_a_longer_run_is_refused(reach, tmp_path):
    run(meta_il(reach, 1), 10, tmp_path)
    shorter = meta_il(reach, 1)
    shorter.iterations = ITERATIONS - 1
    with pytest.raises(ValueError, match="is of iteration 6, the method has 5 iterations"):
        train(shorter, checkpoint=TrainingCheckpoint(tmp_path))


def test_checkpoints_every_no_iterations_are_refused(reach):
    with pytest.raises(ValueError, match="checkpoint_every is 0; expected at least 1"):
        train(meta_il(reach, 1), checkpoint_every=0)


def test_without_a_checkpoint_the_message_says_so(reach):
    method = meta_il(copy.deepcopy(reach), 1)
    huge_actions(method)
    with pytest.raises(TrainingDiverged, match="No checkpoint was saved"):
        train(method)


@pytest.mark.parametrize(("steps", "each"), [(250, 100), (50, 100)])
def test_steps_that_are_not_whole_iterations_are_refused(steps, each, reach):
    model = reach.model()
    with pytest.raises(ValueError, match=f"steps is {steps}.*which is {each}"):
        MetaIL(model, reach.demonstrations, MetaILConfig(steps=steps, steps_per_iteration=each))
