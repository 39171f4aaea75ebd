"""What holds on every face: seeds, and processes that are forked."""

import gc
import os
import signal

import gymnasium
import numpy as np
import pytest
import torch

import pemirl_envs

ID = "pemirl_envs/PointMazeLeft-v0"


def torchrl(seed):
    return pemirl_envs.make("point_maze/left", 1, seed=seed).reset()["observation"][0].tolist()


def torchrl_set_seed(seed):
    env = pemirl_envs.make("point_maze/left", 1, seed=0)
    env.set_seed(seed)
    return env.reset()["observation"][0].tolist()


def dm_control(seed):
    env = pemirl_envs.load("point_maze", "left", {"random": seed})
    return env.reset().observation["observation"].tolist()


def gym(seed):
    return gymnasium.make(ID).unwrapped.reset(seed=seed)[0].tolist()


def gym_vector(seed):
    return gymnasium.make_vec(ID, 1).reset(seed=seed)[0][0].tolist()


FACES = [torchrl, torchrl_set_seed, dm_control, gym, gym_vector]
every_face = pytest.mark.parametrize("begin", FACES)


@every_face
def test_unseeded_environments_differ(begin):
    torch.manual_seed(0)  # no global stream takes part
    np.random.seed(0)  # noqa: NPY002
    first = begin(None)
    torch.manual_seed(0)
    np.random.seed(0)  # noqa: NPY002
    assert begin(None) != first


@every_face
def test_a_face_takes_every_type_of_seed_and_means_the_same_by_it(begin):
    spellings = (5, np.int64(5), np.array([5]), torch.tensor(5), np.random.RandomState(5))
    assert all(begin(seed) == torchrl(5) for seed in spellings)
    seeds = (2**31, 2**32, 2**63, [1, 2], np.array([3, 4]), np.random.RandomState([1, 2]))
    begins = [begin(seed) for seed in seeds]
    assert begins == [torchrl(seed) for seed in seeds]
    assert len({tuple(observation) for observation in begins}) == len(seeds)


@every_face
def test_distinct_seeds_give_distinct_episodes(begin):
    seeds = [*range(5), 2**31 - 1, 2**31, 2**31 + 1, 2**32, 2**32 + 1]
    assert len({tuple(begin(seed)) for seed in seeds}) == len(seeds)


@every_face
@pytest.mark.parametrize(("seed", "kind"), [(-1, ValueError), (1.5, TypeError), (True, TypeError)])
def test_what_is_no_seed_is_refused_on_every_face(begin, seed, kind):
    with pytest.raises(kind, match="the seed is"):
        begin(seed)


# Results were measured with such seeds: their streams may never change.
def test_published_streams():
    assert torchrl(0) == pytest.approx([0.2645775, -0.0443756], abs=1e-6)
    assert torchrl(2**31) == pytest.approx([0.3127444, 0.0104998], abs=1e-6)


def in_fork(action):
    """What an action raises in a forked child, as text; fails where it hangs."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        signal.alarm(20)
        try:
            action()
            message = "nothing"
        except BaseException as error:
            message = f"{type(error).__name__}: {error}"
        os.write(write, message.encode())
        os._exit(0)
    os.close(write)
    with os.fdopen(read) as pipe:
        message = pipe.read()
    assert os.waitpid(child, 0)[1] == 0, "the child hung"
    return message


ACTION = np.ones((4, 2), np.float32)


def begun_torchrl(threads):
    env = pemirl_envs.make("point_maze/left", 4, seed=0, num_threads=threads)
    data = env.reset().set("action", torch.from_numpy(ACTION))
    return lambda: env.step(data), env.reset


def begun_gym_vector(threads):
    env = gymnasium.make_vec(ID, 4, num_threads=threads)
    env.reset(seed=0)
    return lambda: env.step(ACTION), env.reset


def begun_gym(threads):
    env = gymnasium.make(ID)
    env.reset(seed=0)
    return lambda: env.step(ACTION[0]), env.reset


def begun_dm_control(threads):
    env = pemirl_envs.load("point_maze", "left", {"random": 0})
    env.reset()
    return lambda: env.step(ACTION[0]), env.reset


needs_fork = pytest.mark.skipif(not hasattr(os, "fork"), reason="the system does not fork")
forks = pytest.mark.filterwarnings("ignore:.*use of fork:DeprecationWarning")


@needs_fork
@forks
@pytest.mark.parametrize("begun", [begun_torchrl, begun_gym_vector])
def test_a_fork_cannot_use_its_parents_threads_and_says_what_to_do(begun):
    step, reset = begun(2)
    for action in (step, reset):
        message = in_fork(action)
        assert message.startswith("RuntimeError: these 4 simulations step on 2 threads, which stay")
        assert "Make the environment inside the worker: give the worker a factory" in message
        action()  # the parent goes on


@needs_fork
@forks
@pytest.mark.parametrize("begun", [begun_torchrl, begun_gym_vector, begun_gym, begun_dm_control])
def test_what_steps_on_the_callers_thread_goes_on_in_a_fork(begun):
    step, reset = begun(1)
    for action in (step, reset):
        assert in_fork(action) == "nothing"


@needs_fork
@forks
def test_an_environment_made_in_the_fork_works():
    step, _ = begun_torchrl(2)
    step()
    assert in_fork(lambda: begun_torchrl(2)[0]()) == "nothing"


@needs_fork
@forks
def test_a_fork_can_drop_what_it_cannot_use():
    """Freeing a batch waits for its threads, which a forked child does not have."""
    environments = [begun_torchrl(2)]

    def drop():
        environments.clear()
        gc.collect()  # an environment of TorchRL is part of a cycle

    assert in_fork(drop) == "nothing"
