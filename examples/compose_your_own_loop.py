"""Algorithm 1 in a TorchRL loop of your own: what ``pemirl_trl.methods.PEMIRL`` does, taken apart.

From a clone: ``python examples/compose_your_own_loop.py 2 4 2``, so many iterations, contexts and
rollouts of each. The paper's 50 50 16 take a few minutes.
"""

import sys
from collections.abc import Iterator
from functools import partial

from tensordict import TensorDictBase
from torch import Tensor
from torch.optim import Adam
from torchrl.collectors import Collector
from torchrl.envs import TransformedEnv

import pemirl_envs
import pemirl_trl as pt
from pemirl_trl.methods import BatchConfig, DiscriminatorBatches
from pemirl_trl.optim import descend


def meta_train(iterations: int, m: int, k: int) -> Iterator[pt.TrustRegionResult]:
    """Meta-train on Point-Maze with ``m`` contexts of ``k`` rollouts; yields the policy's steps."""
    pile = pt.DemonstrationDataset.load("data/point_maze_train.safetensors").trajectories()
    model = pt.PEMIRLModel(2, 2, 100, standardize=pt.Standardize.fit(pile["observation"]))
    # Each reset draws demonstrations and m ~ q(m | demonstration), which the policy reads.
    infer = pt.InferContext(model.encoder, pile, rollouts_per_context=k)
    env = TransformedEnv(pemirl_envs.make("point_maze/left", num_envs=m * k, seed=0), infer)
    sizes = {"frames_per_batch": m * k * 100, "total_frames": iterations * m * k * 100}
    whole = {"reset_at_each_iter": True, "auto_register_policy_transforms": False}
    negatives = pt.Negatives(20)  # the last 20 iterations
    batches = DiscriminatorBatches(model, pile, negatives, BatchConfig())
    info_loss = pt.InfoLoss(model.encoder, model.reward, rollouts_per_context=k)
    discriminator_loss = pt.DiscriminatorLoss(pt.AIRLDiscriminator(model.reward))
    trpo_loss = pt.TRPOLoss(model.policy)
    advantage = pt.FiniteHorizonAdvantage(rollouts_per_context=k)
    psi = Adam(model.encoder.parameters(), lr=1e-4)
    theta = Adam(model.reward.parameters(), lr=1e-3)
    omega = pt.TrustRegionOptimizer(model.policy.parameters(), max_kl=0.02)

    def policy_losses(batch: TensorDictBase) -> tuple[Tensor, Tensor]:
        losses = trpo_loss(batch)
        return losses["loss_objective"], losses["kl"]

    for rollouts in Collector(env, model.policy, **sizes, **whole):  # [M K, T]
        negatives.add(rollouts)
        # Both losses before either step: psi and theta move simultaneously.
        info, classification = info_loss(rollouts), discriminator_loss(batches.sample(last=20))
        descend(psi, info["loss_info_encoder"])  # reaches psi alone
        descend(theta, classification["loss_discriminator"] + 1e-4 * info["loss_info_reward"])
        pt.LearnedReward(model.reward)(rollouts)  # ("next", "reward") is now r(s, m)
        yield omega.step(partial(policy_losses, advantage(rollouts).reshape(-1)))


if __name__ == "__main__":
    for step in meta_train(*map(int, sys.argv[1:] or (2, 4, 2))):
        print(step)
