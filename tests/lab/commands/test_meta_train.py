"""Meta-training: every method from its name, its options, and what does not fit together."""

import pytest
import torch

from pemirl_lab.commands import meta_train
from pemirl_lab.commands.meta_train import build_method, check_sizes, open_environment, task_space
from pemirl_lab.public_code import PublicCodeInfoLoss
from pemirl_lab.runs.run_folder import RunFolder
from pemirl_trl import DemonstrationDataset
from pemirl_trl.files import read_metadata
from pemirl_trl.methods import METHODS, AveragedReward, new_model
from pemirl_trl.modules import GAILDiscriminator, NoContext
from pemirl_trl.objectives import InfoLoss
from pemirl_trl.pretrained import load_model

from ..conftest import ROOT

SMOKE = ("preset=smoke", "threads=1", "run_dir=smoke", "logger=null")


@pytest.mark.parametrize("method", METHODS)
def test_every_method_leaves_the_model_that_it_trained(method, settings, here):
    few = ("training.batch.trajectories=10", "meta_il.steps=10")
    trained = meta_train.run(*settings("meta_train", f"method={method}", *SMOKE, *few))
    # Meta-IL comes first for whoever has contexts.
    assert (here / "smoke/meta_il.safetensors").exists() == (method != "airl")
    if method == "meta_il":
        assert not (here / "smoke/model.safetensors").exists()
        return
    model = load_model("smoke/model.safetensors")
    for name, value in trained.state_dict().items():
        assert torch.equal(model.state_dict()[name], value), name
    facts = read_metadata("smoke/model.safetensors")
    assert (facts["method"], facts["env_steps"]) == (method, "1600")
    assert isinstance(model.encoder, NoContext) == (method == "airl")
    assert isinstance(model.reward, GAILDiscriminator) == (method == "meta_infogail")
    if method != "airl":
        before = load_model("smoke/meta_il.safetensors").encoder.state_dict()
        after = model.encoder.state_dict()
        still = all(torch.equal(after[name], value) for name, value in before.items())
        assert still == (method in ("pemirl", "pemirl_no_info", "pemirl_contrastive"))


def test_results_do_not_depend_on_the_number_of_threads(smoke, settings, here):
    two = settings(
        "meta_train", "experiment=point_maze", "preset=smoke", "threads=2", "run_dir=two"
    )
    meta_train.run(*two)
    weights = (smoke[0] / "smoke/model.safetensors").read_bytes()
    assert (here / "two/model.safetensors").read_bytes() == weights


@pytest.fixture(scope="module")
def demonstrations():
    return DemonstrationDataset.load(ROOT / "data/point_maze_train.safetensors")[::100]


def test_the_options_of_a_method_reach_it(settings, demonstrations):
    """An averaged reward; the information term of the public code."""
    options = ("reward_average_decay=0.9", "info_estimator=public_code")
    given, _ = settings("meta_train", "preset=smoke", *options)
    model = new_model(demonstrations, given.learning)
    env = open_environment(given, model, demonstrations)
    method = build_method(given, model, demonstrations, env)
    assert isinstance(method, AveragedReward)
    assert method.model is model
    assert isinstance(method.method._info_loss, PublicCodeInfoLoss)
    given, _ = settings("meta_train", "preset=smoke", "method=pemirl")
    assert isinstance(build_method(given, model, demonstrations, env)._info_loss, InfoLoss)


def test_a_reward_may_read_what_the_task_is_about(settings):
    assert task_space(settings("meta_train", "task=ant")[0]) == [13, 14]
    assert task_space(settings("meta_train")[0]) == [0, 1]


def test_demonstrations_of_another_task_are_refused(settings, demonstrations):
    given, _ = settings("meta_train", "task=ant")
    message = r"data/ant_train.safetensors holds .* = \(2, 2, 100\), but ant/normal has \(27, 8, 5"
    with pytest.raises(ValueError, match=message):
        check_sizes(given, demonstrations)


def test_a_file_that_is_not_there_does_not_block_the_right_one(settings, here):
    wrong = settings("meta_train", *SMOKE, "demonstrations=nowhere.safetensors")
    with pytest.raises(FileNotFoundError, match=r"no file nowhere.safetensors"):
        meta_train.run(*wrong)
    RunFolder.of(settings("meta_train", *SMOKE)[0]).release()


def test_demonstrations_that_changed_are_refused(settings, demonstrations, here):
    demonstrations.save("pile.safetensors")
    given = settings("meta_train", *SMOKE, "demonstrations=pile.safetensors", "method=airl")
    meta_train.run(*given)
    demonstrations[:4].save("pile.safetensors")
    message = "pile.safetensors is not the demonstrations that the run in smoke began with"
    with pytest.raises(ValueError, match=message):
        meta_train.run(*given)
