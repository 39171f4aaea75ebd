"""Meta-train q(m | demonstration), r(s, m) and a policy on unlabelled demonstrations.

    python recipes/meta_train.py
    python recipes/meta_train.py method=pemirl seed=1
    python recipes/meta_train.py pemirl.info_coeff=0 model.context_dim=5 run_dir=runs/no_info

Writes ``model.safetensors`` (PEMIRL) and ``meta_il.safetensors`` (the baseline that initialised its
encoder) to ``run_dir``.
"""

from __future__ import annotations

import hydra
import torch
from config import typed
from domains import data_file, environment
from omegaconf import DictConfig
from run_folder import RunFolder, say

from pemirl_trl import DemonstrationDataset, InferContext, ModelConfig, PEMIRLModel, Standardize
from pemirl_trl.methods import (
    PEMIRL,
    MetaIL,
    MetaILConfig,
    PEMIRLConfig,
)
from pemirl_trl.pretrained import save_model


def meta_train(config: DictConfig, folder: RunFolder) -> PEMIRLModel:
    """Meta-IL, then PEMIRL with its encoder and a fresh policy."""
    torch.manual_seed(config.seed)
    demonstrations = DemonstrationDataset.load(data_file(config.demonstrations))
    model = PEMIRLModel(
        demonstrations.observation_dim,
        demonstrations.action_dim,
        demonstrations.horizon,
        typed(ModelConfig, config.model),
        Standardize.fit(demonstrations.trajectories()["observation"]),
    )
    trajectories = demonstrations.trajectories()
    folder.train(
        "meta-il",
        MetaIL(model, trajectories, typed(MetaILConfig, config.meta_il)),
        show="meta_il/loss_imitation",
    )
    save_model(folder.file("meta_il.safetensors"), model)
    model.policy = model.new_policy(learn_scale=False)
    method = _pemirl(config, model, demonstrations)
    folder.train(config.method, method, show="return/true")
    facts = {"method": config.method, "env_steps": str(method.env_steps)}
    file = folder.file("model.safetensors")
    save_model(file, model, facts)
    say(f"meta-trained on {method.env_steps:,} environment steps -> {file}")
    return model


def _pemirl(config: DictConfig, model: PEMIRLModel, demonstrations: DemonstrationDataset) -> PEMIRL:
    settings = typed(PEMIRLConfig, config.pemirl)
    trajectories = demonstrations.trajectories()
    transform = InferContext(
        model.encoder,
        trajectories,
        rollouts_per_context=settings.rollouts_per_context,
        # The environment is reset to the demonstrated task, so that its reward is a metric.
        tasks=None if demonstrations.task is None else demonstrations.tasks(),
    )
    env = environment(
        config.environment,
        config.contexts_per_batch * settings.rollouts_per_context,
        transform,
        seed=config.seed,
        threads=config.threads,
    )
    return PEMIRL(model, env, trajectories, settings)


@hydra.main(config_path="conf", config_name="meta_train", version_base="1.3")
def main(config: DictConfig) -> None:
    """Entry point."""
    meta_train(config, RunFolder(config))


if __name__ == "__main__":
    main()
