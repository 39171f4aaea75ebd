"""Every task with every method: composed, typed, and run for one iteration of each stage."""

import pytest
import torch

from pemirl_lab.commands import meta_train
from pemirl_lab.commands.adapt_reward import adapt
from pemirl_lab.runs.composition import CONF
from pemirl_lab.runs.run_folder import RunFolder
from pemirl_trl import DemonstrationDataset
from pemirl_trl.methods import METHODS

from .conftest import ROOT

TASKS = sorted(file.stem for file in (CONF / "task").glob("*.yaml"))
EVERY = [(task, method) for task in TASKS for method in METHODS]
FAST = {"point_maze", "sweeper"}
"""With all methods; of the others those that once were broken, or that are published."""
ALSO_FAST = {
    ("ant", "airl"),
    ("ant", "pemirl_contrastive"),
    ("sawyer_pusher", "pemirl_contrastive"),
}
SMALLEST = (
    "preset=smoke", "threads=1", "logger=null", "run_dir=run", "meta_il.steps=1",
    "meta_il.steps_per_iteration=1", "meta_il.batch_size=2", "contexts_per_batch=2",
    "training.iterations=1", "training.rollouts_per_context=2", "training.batch.trajectories=2",
    "demonstrations=train.safetensors", "test_demonstrations=test.safetensors",
    "demonstrations_per_task=1", "adaptation.rollouts=2", "adaptation.optimization.iterations=1",
)  # fmt: skip


@pytest.mark.parametrize(("task", "method"), EVERY)
def test_a_method_keeps_what_makes_it_on_every_task(settings, task, method):
    given, _ = settings("meta_train", f"task={task}", f"method={method}")
    assert (given.task, given.method) == (task, method)
    learning, library = given.learning, METHODS[method]
    assert type(learning.training) is type(library.training)
    for name in ("algorithm", "initial_encoder", "initial_policy", "reward_reads"):
        assert getattr(learning, name) == getattr(library, name)
    assert learning.model.context_dim == library.model.context_dim


@pytest.fixture(scope="module")
def few():
    """Four demonstrations of the training tasks, and two of unseen ones."""
    return {
        (task, split): DemonstrationDataset.load(ROOT / f"data/{task}_{split}.safetensors")[chosen]
        for task in TASKS
        for split, chosen in (("train", slice(0, None, 40)), ("test", slice(0, 2)))
    }


@pytest.mark.parametrize(
    ("task", "method"),
    [
        pytest.param(*pair, marks=() if pair[0] in FAST or pair in ALSO_FAST else pytest.mark.long)
        for pair in EVERY
    ],
)
def test_every_method_runs_on_every_task(settings, here, few, task, method):
    for split in ("train", "test"):
        few[task, split].save(f"{split}.safetensors")
    given, _ = settings("adapt_reward", f"task={task}", f"method={method}", *SMALLEST)
    folder = RunFolder.of(given)
    model = meta_train.meta_train(given, folder)
    before = {name: value.clone() for name, value in model.state_dict().items()}
    policy, steps = adapt(given, folder, model)
    assert steps == 2 * model.horizon
    assert all(torch.isfinite(value).all() for value in policy.state_dict().values())
    assert all(torch.equal(model.state_dict()[name], value) for name, value in before.items())
