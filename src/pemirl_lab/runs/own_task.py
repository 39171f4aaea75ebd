"""Runs on an environment of the user's own, ``env=my_module:make_env``, in ``key=value`` words."""

from __future__ import annotations

import dataclasses
import functools
import importlib
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from pathlib import Path
from typing import Any, Literal, TypeVar

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from pydantic.dataclasses import dataclass
from yaml import YAMLError

from pemirl_lab.runs.run_folder import RunFolder
from pemirl_trl import DemonstrationDataset
from pemirl_trl.configuration import CHECKED, Count, Device, SeedNumber, typed
from pemirl_trl.methods.environments import check_signature

Values = TypeVar("Values")


@dataclass(frozen=True, config=CHECKED)
class OwnTask:
    """What the commands on a user's environment share.

    Attributes:
        env: ``"my_module:make_env"``; see :data:`pemirl_trl.methods.MakeEnv`.
        run_dir: where the run writes; the same command resumes it.
        seed, device, logger, checkpoint_every: as in the other commands.
        observation_keys: which entries of what it observes make the observation, in this order;
            also of demonstrations that have several entries.
        discrete_actions: n, of demonstrations whose actions are integers from 0 to n - 1.
        settings: of the library, by their dotted names: what is none of the values above.
    """

    env: str
    run_dir: str
    seed: SeedNumber = 0
    device: Device = "cpu"
    logger: Literal["csv", "tensorboard"] | None = "csv"
    checkpoint_every: Count = 25
    observation_keys: Sequence[str] | None = None
    discrete_actions: Count | None = None
    settings: dict[str, Any] = field(default_factory=dict)

    def demonstrations_in(self, file: Path) -> DemonstrationDataset:
        """What a file or folder of demonstrations holds, of whatever format."""
        return DemonstrationDataset.load(
            file, observation_keys=self.observation_keys, discrete_actions=self.discrete_actions
        )

    def when_begun(self, inputs: Mapping[str, Path]) -> Callable[[], RunFolder]:
        """What makes the folder of the run, once: an environment that is refused leaves none.

        Args:
            inputs: what the run reads, by role.
        """

        @functools.cache
        def opened() -> RunFolder:
            folder = self.folder()
            for role, file in inputs.items():
                folder.reads(role, file)
            return folder

        return opened

    def folder(self) -> RunFolder:
        """The folder of the run."""
        return RunFolder(
            self.run_dir,
            dataclasses.asdict(self),
            logger=self.logger,
            checkpoint_every=self.checkpoint_every,
        )


def is_own(arguments: Sequence[str]) -> bool:
    """Whether a command line names an environment of the user's own."""
    return any(text.startswith("env=") for text in arguments)


def parse_words(arguments: Sequence[str], values: type[Values], *, rest: bool = False) -> Values:
    """Typed values of ``key=value`` words, nested as ``a.b=value``, each value as YAML.

    Args:
        arguments: the words.
        values: a dataclass.
        rest: whether words of other names are the library's, and go to ``settings``.

    Raises:
        ValueError: something that is no such word, or every wrong or missing value by its name.
    """
    strange = [text for text in arguments if "=" not in text or text.startswith(("-", "+", "~"))]
    if strange:
        raise ValueError(f"got {' '.join(strange)}; expected words like key=value")
    try:
        given: Any = OmegaConf.to_container(OmegaConf.from_dotlist(list(arguments)), resolve=True)
    except (OmegaConfBaseException, YAMLError, ValueError) as error:
        raise ValueError(f"cannot read {' '.join(arguments)}: {error}") from error
    fields = dataclasses.fields(values)  # type: ignore[arg-type]
    own = {f.name for f in fields} - {"settings"}
    missing = [
        f.name
        for f in fields
        if f.name not in given
        and f.default is dataclasses.MISSING
        and f.default_factory is dataclasses.MISSING
    ]
    if missing:
        raise ValueError("missing " + ", ".join(f"{name}=..." for name in missing))
    if rest:
        library = {name: given.pop(name) for name in sorted(given.keys() - own)}
        given["settings"] = library
    return typed(values, given)


def load_make_env(name: str) -> Callable[[int, int], Any]:
    """The function that ``"my_module:make_env"`` names; modules of the working directory count.

    Raises:
        ValueError: there is no such module or function, and it says where it was looked for; or it
            cannot be called with a number and a seed.
    """
    make_env = load_function(name, "env", "make_env")
    try:
        check_signature(make_env, name.partition(":")[2])
    except TypeError as error:
        raise ValueError(f"env={name}: {error}") from error
    return make_env


def load_function(name: str, word: str, example: str = "function") -> Callable[..., Any]:
    """The function that ``"my_module:function"`` names; modules of the working directory count.

    Args:
        name: as it was given, as the value of ``word``.
        word: of the command line, for the message.
        example: what a function is called there.

    Raises:
        ValueError: there is no such module or function; says where it was looked for.
    """
    module_name, colon, function = name.partition(":")
    if not (module_name and colon and function):
        raise ValueError(f"{word}={name}: expected module:function, such as my_module:{example}")
    if module_name.endswith(".py") or "/" in module_name:
        stem = Path(module_name).stem
        raise ValueError(
            f"{word}={name}: expected the name of a module and not of its file: {stem}:{function}, "
            f"from the folder that {stem}.py lies in"
        )
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.insert(0, here)
    try:
        module = importlib.import_module(module_name)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module_name}.".startswith(f"{error.name}."):
            raise  # a module that the user's own imports
        raise ValueError(
            f"{word}={name}: no module {module_name} in {here} or among what is installed"
        ) from error
    found = getattr(module, function, None)
    if not callable(found):
        there = [
            k
            for k, v in vars(module).items()
            if callable(v) and not k.startswith("_") and v.__module__ == module_name
        ]
        raise ValueError(
            f"{word}={name}: {module.__file__} has no function {function}; it has {sorted(there)}"
        )
    return found
