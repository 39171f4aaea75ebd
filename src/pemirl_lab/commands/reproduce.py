"""Run every row of a table, over seeds: the paper's experiments, the baselines, the ablations.

    python recipes/reproduce.py table=point_maze
    python recipes/reproduce.py table=ant
    python recipes/reproduce.py table=ablations
    python recipes/reproduce.py table=point_maze hydra.launcher.n_jobs=4
    python recipes/reproduce.py hydra.mode=RUN row=pemirl seed=0                   # one run
    python recipes/reproduce.py hydra/launcher=submitit_slurm              # hydra-submitit-launcher
    python recipes/reproduce.py hydra/launcher=ray                         # hydra-ray-launcher
    python recipes/reproduce.py -m table=ablations row=base,info_none seed=0,1     # some of a table

One job per row and seed (conf/table, conf/row), as many at a time as ``hydra.launcher.n_jobs``.
Each seed has its own demonstrations and its own Meta-IL, which all its rows share. A job writes
``results/TABLE/ROW/seedN.json``; the same command does what is missing, and resumes what died.
``python recipes/report.py --write`` turns the files into pages.
"""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path

import hydra
import torch
from adapt_reward import adapt, load_test_demonstrations
from behaviours import behaviour_measures
from collect_demos import collect_demos
from config import changed_settings, plain
from evaluate import read_curve, read_seconds
from filelock import FileLock
from meta_train import meta_train, train_meta_il
from omegaconf import DictConfig, OmegaConf
from reward_report import measure_reward
from run_folder import RunFolder, say
from scoring import Scorer, context_measures

from pemirl_trl import DemonstrationDataset, PEMIRLModel
from pemirl_trl.evaluation import Result, Score, environment_facts, read
from pemirl_trl.files import read_metadata

META_IL_FIELDS = ("seed", "environment", "demonstrations", "meta_il", "preset")
"""What Meta-IL depends on, beside the sizes of the model."""


def run(config: DictConfig) -> Result | None:
    """One row, one seed: demonstrations, Meta-IL, the method, its policies, their scores."""
    output = Path(config.results) / f"seed{config.seed}.json"
    if config.seed >= config.seeds or output.exists():
        say(f"{config.row}, seed {config.seed}: nothing to do{stored_otherwise(config, output)}")
        return None
    draw_demonstrations(config)
    meta_il, meta_il_run = shared_meta_il(config)
    folder = RunFolder(config)
    if config.algorithm != "meta_il":
        model = meta_train(config, folder, meta_il)
    elif meta_il is not None:
        model = meta_il
    else:
        raise ValueError("algorithm=meta_il needs contexts; got model.context_dim=0")
    demonstrations = load_test_demonstrations(config)
    scores = measure(config, folder, model, demonstrations)
    reward = context_measures(config, model)
    if not config.planar and config.measure.reward_adaptation:
        reward |= behaviour_measures(config, model)
    if config.measure_reward:
        with folder.timed("reward_report"):
            reward |= measure_reward(config, model, demonstrations).summary()
    stages = sorted(file.stem for file in folder.file("curves").glob("*.json"))
    result = Result(
        table=config.table_name,
        row=config.row,
        task=config.task,
        seed=config.seed,
        split=config.test_split,
        scores=tuple(scores),
        reward=reward,
        curves={stage: read_curve(folder.path, stage) for stage in stages},
        seconds={**read_seconds(meta_il_run), **read_seconds(folder.path)},
        config=plain(config),
        **environment_facts(),
    )
    result.write(output)
    say(f"{config.row}, seed {config.seed} -> {output}")
    return result


def stored_otherwise(config: DictConfig, output: Path) -> str:
    """Which settings of a stored result are not those of now; what runs it with them."""
    if not output.exists():
        return ""
    changed = changed_settings(read(output).config, plain(config), ignore=("threads", "logger"))
    return f"; stored with {', '.join(changed)}: delete {output} to run it anew" if changed else ""


def measure(
    config: DictConfig, folder: RunFolder, model: PEMIRLModel, demonstrations: DemonstrationDataset
) -> list[Score]:
    """Scores of all settings and dynamics that the row asks for."""
    scorer = Scorer(config, demonstrations)
    trained = folder.file("model.safetensors")
    steps = int(read_metadata(trained)["env_steps"]) if trained.exists() else 0
    scores = []
    for setting, environments in config.measure.items():
        for name in environments:
            policy, adaptation = model.policy, 0
            if setting in ("reward_adaptation", "rl_with_true_reward"):
                policy, adaptation = adapt(
                    config,
                    folder,
                    model,
                    environment_name=name,
                    stage=f"{setting}-{name.split('/')[1]}",
                    true_reward=setting == "rl_with_true_reward",
                )
            used = {"meta_training": steps, "adaptation": adaptation}
            with folder.timed("evaluation"):
                scores += scorer.scores(setting, name, model, policy, used)
    return scores


def draw_demonstrations(config: DictConfig) -> None:
    """This seed's own demonstrations of the training and of the unseen tasks."""
    wanted = {
        config.demonstrations: (config.train_split, config.train_per_task),
        config.test_demonstrations: (config.test_split, config.demonstrations_per_task),
    }
    for output, (split, per_task) in wanted.items():
        Path(output).parent.mkdir(parents=True, exist_ok=True)
        with FileLock(f"{output}.lock"):
            if not Path(output).exists():
                settings = {
                    "split": split,
                    "per_task": per_task,
                    "output": output,
                    "expert": config.experts[config.environment.split("/")[1]],
                }
                collect_demos(OmegaConf.create({**plain(config), **settings}))


def shared_meta_il(config: DictConfig) -> tuple[PEMIRLModel | None, Path]:
    """Meta-IL's model, trained once for all rows that start from the same; and its folder.

    None for a method without contexts.
    """
    if config.model.context_dim == 0:
        return None, Path(config.run_dir)
    sizes = {k: v for k, v in plain(config.model).items() if k not in ("reward", "reward_features")}
    given = {name: plain(config)[name] for name in META_IL_FIELDS}
    identity = json.dumps([given, sizes], sort_keys=True)
    name = hashlib.sha256(identity.encode()).hexdigest()[:12]
    run_dir = f"{config.shared_dir}/meta_il/{name}-seed{config.seed}"
    mine = OmegaConf.create(
        {
            **given,
            "model": {**sizes, "reward": "shaped"},
            "run_dir": run_dir,
            "logger": config.logger,
            "checkpoint_every": config.checkpoint_every,
        }
    )
    Path(run_dir).mkdir(parents=True, exist_ok=True)
    with FileLock(f"{run_dir}/lock"):
        return train_meta_il(mine, RunFolder(mine)), Path(run_dir)


@hydra.main(config_path="conf", config_name="reproduce", version_base="1.3")
def main(config: DictConfig) -> None:
    """Entry point."""
    torch.set_num_threads(1)
    run(config)


if __name__ == "__main__":
    # Launchers that start processes anew (submitit, Ray) have to find this folder's modules.
    paths = (str(Path(__file__).resolve().parent), os.environ.get("PYTHONPATH"))
    os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, paths))
    main()
