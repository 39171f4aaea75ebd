"""One training that collects in several processes: weights, seeds, and deaths of workers."""

import os
import signal
import sys
import threading
from functools import partial

import pytest
import torch

from pemirl_lab.commands import meta_train
from pemirl_lab.commands.meta_train import training_environment
from pemirl_lab.runs.places import RunRefused, data_file
from pemirl_trl import DemonstrationDataset
from pemirl_trl.methods import PEMIRL, EpisodeCollector, WorkerCollector, new_model
from pemirl_trl.methods.worker_collection import Share, shares_of

SMOKE = ("preset=smoke", "threads=1", "logger=null", "run_dir=smoke", "meta_il.steps=10")


@pytest.fixture
def parts(settings, here):
    """Of a smoke run: a new model, and what makes the environment of a share."""
    given, _ = settings("meta_train", *SMOKE)
    demonstrations = DemonstrationDataset.load(data_file(given.demonstrations))[:20]
    model = new_model(demonstrations, given.learning)
    return model, partial(training_environment, given, demonstrations)


def same(a, b):
    keys = set(a.keys(True, True))
    return keys == set(b.keys(True, True)) and all(torch.equal(a[k], b[k]) for k in keys)


def test_a_share_is_a_function_of_weights_and_seeds(parts):
    model, make_env = parts
    weights = {name: value.clone() for name, value in model.state_dict().items()}
    once, again = Share(make_env, model, 2), Share(make_env, model, 2)
    first = once.collect(weights, 5, 6)
    assert not same(first, once.collect(weights, 7, 6))  # another environment's seed
    assert not same(first, once.collect(weights, 5, 7))  # other actions and contexts
    other = {name: value + 0.1 for name, value in weights.items()}
    assert not same(first, once.collect(other, 5, 6))
    assert same(first, once.collect(weights, 5, 6))
    assert same(first, again.collect(weights, 5, 6))


def test_a_share_is_what_a_collector_of_that_size_collects(parts):
    model, make_env = parts
    env = make_env(model, 3)
    collector = EpisodeCollector(env, model.policy, model.horizon)
    share = Share(make_env, model, 3)
    rollouts = share.collect(model.state_dict(), 5, 6)
    env.set_seed(5)
    torch.manual_seed(6)
    assert same(rollouts, collector())
    assert share.facts() == (collector.frames, True) == (3 * 2 * 100, True)


def test_contexts_are_divided_evenly():
    assert shares_of(50, 4) == [13, 13, 12, 12]
    with pytest.raises(ValueError, match="got 3 workers for 2 contexts; expected at most as many"):
        shares_of(2, 3)


def test_without_ray_workers_are_refused_with_the_cure(settings, here, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(RunRefused, match=r'workers=2: .*pip install "pemirl-trl\[ray\]"'):
        meta_train.run(*settings("meta_train", *SMOKE, "workers=2"))


@pytest.fixture(scope="module")
def ray():
    """A cluster of two CPUs on this machine."""
    ray = pytest.importorskip("ray", reason='workers need Ray: pip install "pemirl-trl[ray]"')
    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    yield ray
    ray.shutdown()


needs_ray = pytest.mark.filterwarnings("ignore")  # Ray's own, in what it imports


@needs_ray
def test_a_worker_that_dies_costs_time_and_nothing_else(ray, parts):
    model, make_env = parts

    def batches(*deaths):
        torch.manual_seed(3)
        collect = WorkerCollector(make_env, model, [2, 1])
        found = []
        for number in range(3):
            if number in deaths:
                pid = ray.get(collect._workers[0].__ray_call__.remote(lambda _: os.getpid()))
                threading.Timer(0.05, os.kill, (pid, signal.SIGKILL)).start()
            found.append(collect())
            if number in deaths:
                now = ray.get(collect._workers[0].__ray_call__.remote(lambda _: os.getpid()))
                assert now != pid
        collect.close()
        return found

    healthy = batches()
    assert healthy[0].shape == (6, 100)
    assert not same(healthy[0], healthy[1])
    assert all(map(same, healthy, batches(1)))


@needs_ray
def test_weights_of_policy_and_encoder_reach_the_workers(ray, parts):
    model, make_env = parts
    collect = WorkerCollector(make_env, model, [1, 1])
    assert collect()["context"].abs().max() > 1e-6
    with torch.no_grad():
        for parameter in [*model.encoder.parameters(), *model.policy.parameters()]:
            parameter.zero_()
        model.encoder.get_submodule("module.0.net.head").log_scale.fill_(-20.0)
    rollouts = collect()
    collect.close()
    assert rollouts["context"].abs().max() < 1e-6
    assert rollouts["loc"].abs().max() == 0


@needs_ray
def test_a_training_with_workers_resumes_bit_for_bit(ray, settings, here, monkeypatch):
    few = (*SMOKE, "workers=2", "training.batch.trajectories=10")
    whole = meta_train.run(*settings("meta_train", *few)).state_dict()
    iteration = PEMIRL.iteration

    def stopped(method):
        if method.env_steps:
            raise KeyboardInterrupt
        return iteration(method)

    monkeypatch.setattr(PEMIRL, "iteration", stopped)
    with pytest.raises(KeyboardInterrupt):
        meta_train.run(*settings("meta_train", *few, "run_dir=part"))
    monkeypatch.undo()
    resumed = meta_train.run(*settings("meta_train", *few, "run_dir=part")).state_dict()
    assert [name for name, value in whole.items() if not torch.equal(value, resumed[name])] == []


@needs_ray
def test_more_workers_than_the_cluster_holds_are_refused(ray, settings, here):
    with pytest.raises(RunRefused, match=r"take 3 CPUs .* and this Ray cluster has 2"):
        meta_train.run(*settings("meta_train", *SMOKE, "workers=3"))
