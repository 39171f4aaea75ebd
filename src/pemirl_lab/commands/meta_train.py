"""Meta-train q(m | demonstration), r(s, m) and a policy on unlabelled demonstrations.

    python recipes/meta_train.py
    python recipes/meta_train.py method=pemirl seed=1
    python recipes/meta_train.py method=airl
    python recipes/meta_train.py task=ant
    python recipes/meta_train.py training.info_coeff=0 model.context_dim=5 run_dir=runs/no_info

Writes ``model.safetensors`` and, where the method has contexts, ``meta_il.safetensors`` (Meta-IL:
a baseline, and what initialises the encoder) to ``run_dir``.
"""

from __future__ import annotations

import dataclasses

import hydra
import torch
from config import typed
from domains import data_file
from methods import build
from omegaconf import DictConfig
from run_folder import RunFolder, say

from pemirl_trl import DemonstrationDataset, ModelConfig, PEMIRLModel, Standardize
from pemirl_trl.methods import MetaIL, MetaILConfig
from pemirl_trl.pretrained import save_model


def load_demonstrations(config: DictConfig) -> DemonstrationDataset:
    """The unlabelled pile."""
    return DemonstrationDataset.load(data_file(config.demonstrations))


def new_model(
    config: DictConfig, demonstrations: DemonstrationDataset, **sizes: object
) -> PEMIRLModel:
    """An untrained model of the configured sizes, less what ``sizes`` replaces."""
    return PEMIRLModel(
        demonstrations.observation_dim,
        demonstrations.action_dim,
        demonstrations.horizon,
        dataclasses.replace(typed(ModelConfig, config.model), **sizes),  # type: ignore[arg-type]
        Standardize.fit(demonstrations.trajectories()["observation"]),
    )


def train_meta_il(config: DictConfig, folder: RunFolder) -> PEMIRLModel:
    """Meta-IL's encoder and policy, to ``meta_il.safetensors``."""
    torch.manual_seed(config.seed)
    demonstrations = load_demonstrations(config)
    model = new_model(config, demonstrations, reward="shaped")  # it has no use for the reward
    method = MetaIL(model, demonstrations.trajectories(), typed(MetaILConfig, config.meta_il))
    folder.train("meta-il", method, show="meta_il/loss_imitation")
    save_model(folder.file("meta_il.safetensors"), model)
    return model


def meta_train(
    config: DictConfig, folder: RunFolder, meta_il: PEMIRLModel | None = None
) -> PEMIRLModel:
    """Meta-IL, where the method has contexts and it is not given; then the method."""
    if meta_il is None and config.model.context_dim > 0:
        meta_il = train_meta_il(config, folder)
    torch.manual_seed(config.seed)
    demonstrations = load_demonstrations(config)
    model = new_model(config, demonstrations)
    for name in ("encoder", "policy"):
        if config[f"initial_{name}"] == "meta_il":
            if meta_il is None:
                raise ValueError(f"initial_{name}=meta_il needs contexts; got context_dim=0")
            model.get_submodule(name).load_state_dict(meta_il.get_submodule(name).state_dict())
    model.policy.log_scale.requires_grad_(config.learn_policy_scale)
    method = build(config, model, demonstrations)
    folder.train(config.method, method, show="return/true")
    facts = {"method": config.method, "env_steps": str(method.env_steps)}
    file = folder.file("model.safetensors")
    save_model(file, model, facts)
    say(f"meta-trained on {method.env_steps:,} environment steps -> {file}")
    return model


@hydra.main(config_path="conf", config_name="meta_train", version_base="1.3")
def main(config: DictConfig) -> None:
    """Entry point."""
    meta_train(config, RunFolder(config))


if __name__ == "__main__":
    main()
