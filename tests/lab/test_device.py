"""Commands whose learner is on a device: what they leave is the CPU's, and the CPU's numbers."""

from copy import deepcopy

import pytest
import torch
from safetensors.torch import load_file

from pemirl_lab.commands import adapt_reward, meta_train, train_expert
from pemirl_trl.pretrained import load_model

from ..pretend_device import DEVICE, PretendDevice
from .conftest import ROOT

pytestmark = pytest.mark.filterwarnings("ignore:.*copying from a non-meta parameter:UserWarning")
FEW = ("preset=smoke", "threads=1", "logger=null", "training.batch.trajectories=10")
RUNS = {
    "meta_train": (meta_train, ("method=pemirl_robust", "meta_il.steps=10"), "model"),
    "public_code": (meta_train, ("info_estimator=public_code", "meta_il.steps=10"), "model"),
    "adapt_reward": (adapt_reward, (f"model_file={ROOT}/zoo/point_maze.safetensors",), "policy"),
    "train_expert": (
        train_expert,
        ("expert_training.optimization.iterations=1", "output=there/expert.safetensors"),
        "expert",
    ),
}


def elsewhere(settings):
    """The settings with the pretended device, which their check would refuse."""
    object.__setattr__(settings, "device", str(DEVICE))
    return settings


@pytest.mark.parametrize("name", RUNS)
def test_a_command_leaves_what_it_leaves_on_the_cpu(name, settings, here, monkeypatch):
    model = load_model("point_maze")  # not under the mode: reading uses "meta" for its own ends
    monkeypatch.setattr(adapt_reward, "load_model", lambda file: deepcopy(model))
    module, words, file = RUNS[name]
    command = module.__name__.rsplit(".", 1)[-1]
    given, own = settings(command, *FEW, "run_dir=there", *words)
    with PretendDevice():
        module.run(elsewhere(given), own)
    left = load_file(f"there/{file}.safetensors")
    module.run(
        *settings(command, *FEW, "run_dir=here", *(w.replace("there", "here") for w in words))
    )
    expected = load_file(f"here/{file}.safetensors")
    assert expected.keys() == left.keys()
    assert [name for name in left if not torch.equal(left[name], expected[name])] == []
