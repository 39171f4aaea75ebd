"""Trust-region steps in TorchRL's own trainer, on points of a line."""

import subprocess
import sys

import pytest
import torch
from tensordict import TensorDict
from torchrl.collectors import Collector
from torchrl.envs import TransformedEnv
from torchrl.trainers import Trainer

from pemirl_trl.modules import ContextPolicy, NoContext
from pemirl_trl.objectives import FiniteHorizonAdvantage, TRPOLoss
from pemirl_trl.optim import TrustRegionOptimizer
from pemirl_trl.optim.trainer import TrustRegionStepper
from pemirl_trl.transforms import InferContext

from ..transforms.toy import Line

N, T, ITERATIONS, MAX_KL = 64, 3, 12, 0.05


@pytest.fixture
def policy():
    return ContextPolicy(2, 1, 0, hidden=(8,))


@pytest.fixture
def trainer(policy):
    demonstrations = TensorDict({"observation": torch.zeros(1, T, 2)}, [1])
    env = TransformedEnv(Line(N, T), InferContext(NoContext(), demonstrations))

    def build(optimizer, **options):
        trainer = Trainer(
            collector=Collector(
                env,
                policy,
                frames_per_batch=N * T,
                total_frames=ITERATIONS * N * T,
                auto_register_policy_transforms=False,
            ),
            total_frames=ITERATIONS * N * T,
            frame_skip=1,
            optim_steps_per_batch=1,
            loss_module=TRPOLoss(policy),
            optimizer=optimizer,
            optimization_stepper=TrustRegionStepper(**options),
            progress_bar=False,
            log_interval=1,
        )
        trainer.register_op("batch_process", FiniteHorizonAdvantage())
        return trainer

    return build


def test_the_trainer_learns_by_steps_inside_the_region(policy, trainer):
    returns, logged = [], []
    trainer = trainer(TrustRegionOptimizer(policy.parameters(), max_kl=MAX_KL))
    trainer.register_op(
        "pre_steps_log",
        lambda batch: returns.append(batch["next", "reward"].sum(1).mean().item()),
    )
    stepper = trainer.optimization_stepper
    step = stepper.step
    stepper.step = lambda *args: logged.append(step(*args)) or logged[-1]
    trainer.train()
    assert len(logged) == ITERATIONS
    for losses in logged:
        assert losses["trust_region/accepted"] == 1
        assert 0 < losses["trust_region/kl"] <= MAX_KL
        assert losses["trust_region/improvement"] > 0
        assert losses["kl"] == 0  # what is logged of the loss is that before the step
        assert not any(value.requires_grad for value in losses.values())
    assert returns[-1] > returns[0] / 2  # returns are negative: half of the way to zero


def test_another_optimiser_is_refused(policy, trainer):
    trainer = trainer(torch.optim.Adam(policy.parameters()))
    with pytest.raises(TypeError, match=r"optimizer=TrustRegionOptimizer\(\.\.\.\), got Adam"):
        trainer.train()


def test_the_settings_travel_with_the_trainers_state(policy, trainer):
    source = trainer(TrustRegionOptimizer(policy.parameters(), max_kl=MAX_KL))
    target = trainer(TrustRegionOptimizer(policy.parameters()))
    target.load_state_dict(source.state_dict())
    assert target.optimizer.param_groups[0]["max_kl"] == MAX_KL


def test_the_library_is_imported_without_the_trainer_and_its_warnings():
    command = "import sys, pemirl_trl; sys.exit('torchrl.trainers' in sys.modules)"
    subprocess.run([sys.executable, "-W", "error", "-c", command], check=True)
