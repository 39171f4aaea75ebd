"""``--help`` of a command on an environment of the user's own."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from types import ModuleType
from typing import Any

from pemirl_lab.runs.validation import leaves
from pemirl_trl.methods import METHODS, AdaptationConfig
from pemirl_trl.methods.defaults import PRESETS

_FORMATS = """a file of DemonstrationDataset.save; an .npz of observation [M, T+1, S] and
action [M, T, A]; an .npz or a folder of imitation; an .hdf5 of D4RL; the folder of a LeRobot
dataset; minari:NAME. pemirl check FILE looks at it"""
WORDS: Mapping[str, str] = {
    "env": """my_module:make_env, of my_module.py in this folder or of what is installed.
make_env(num_envs, seed) returns a TorchRL environment of batch size [num_envs] (SerialEnv,
ParallelEnv, or its own), a Gymnasium vector environment of as many (autoreset_mode DISABLED or
SAME_STEP), or a single Gymnasium environment, which is then made for each. It is asked for
hundreds at a time""",
    "run_dir": "where the run writes; the same command resumes it",
    "demonstrations": f"of many tasks, unlabelled: {_FORMATS}",
    "test_demonstrations": f"one of each new task: {_FORMATS}",
    "model_file": "of pemirl meta_train, or a name of the zoo",
    "preset": """robust, where observations are what the task is about; contrastive, where a body or
an object stands in between (needs task_space); paper, the published method""",
    "task_space": "which components of an observation the task is about: [0,1]",
    "exploration": """wide, for a point that has to find another way, or narrow, for a gait that
must not be lost; null lets short tries choose""",
    "observation_keys": """which entries make the observation, of an environment or of
demonstrations that have several: [place,arm.angle]""",
    "discrete_actions": "n, of demonstrations whose actions are integers from 0 to n - 1",
    "seed": "of everything random",
    "device": "of the learner: cpu, or cuda where there is one",
    "logger": "csv, tensorboard or null",
    "checkpoint_every": "iterations",
    "reward": "module:function, or the file or the zoo's name of a reward",
    "true_reward": "module:function of observations and of what the task is",
    "encoder_file": "of a function as reward: whose q says what m is",
    "numbers": "of a function as reward: torch or numpy",
    "gamma": "of a function as reward: discount of the shaping that distances do not see",
    "report": "what is measured: report.episodes=20 and the like",
}
"""What each value is."""
_LIBRARY: Mapping[str, Any] = {
    "meta_train": METHODS[PRESETS["robust"]],
    "adapt_reward": AdaptationConfig(),
}
_FITS = """What has to fit: the environment observes as many numbers, and takes as many actions, as
the demonstrations have; its time limit is that of the longest demonstration, or there is none; an
episode may end by itself (terminated) before. Actions beyond its bounds are its own to clip."""


def help_on_own(command: str, module: ModuleType) -> str:
    """The values of a command on an environment of the user's own, and what they mean."""
    fields = [f for f in dataclasses.fields(module.OwnEnvironment) if f.name != "settings"]
    fields.sort(key=lambda field: field.default is not dataclasses.MISSING)
    lines = [
        f"usage: pemirl {command} env=my_module:make_env key=value ...\n",
        module.__doc__ or "",
    ]
    lines += [_entry(field) for field in fields]
    lines.append(f"\n{_FITS}")
    if command in _LIBRARY:
        lines.append(
            "\nSettings of the library; some follow from the demonstrations, and are shown when it "
            "begins.\nEach can be given by its name; these are the others' values:\n"
        )
        values = leaves(dataclasses.asdict(_LIBRARY[command]))
        lines += [f"  {name}={_shown(value)}" for name, value in values]
    return "\n".join(lines)


def _entry(field: dataclasses.Field[Any]) -> str:
    """A value with its default, and below it what it is."""
    default = ""
    if field.default is not dataclasses.MISSING:
        default = f"={_shown(field.default)}"
    elif field.default_factory is dataclasses.MISSING:
        default = "  (needed)"
    text = WORDS[field.name].replace("\n", "\n      ")
    return f"  {field.name}{default}\n      {text}"


def _shown(value: Any) -> str:
    return (
        "null" if value is None else str(value).lower() if isinstance(value, bool) else f"{value}"
    )
