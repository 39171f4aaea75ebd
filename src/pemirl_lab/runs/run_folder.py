"""One folder per run: configuration, versions, inputs, metrics, checkpoints, figures."""

from __future__ import annotations

import contextlib
import hashlib
import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml
from filelock import FileLock, Timeout
from torchrl.record.loggers import Logger, get_logger
from tqdm import tqdm
from tqdm.contrib.logging import logging_redirect_tqdm

from pemirl_lab.results import environment_facts
from pemirl_lab.runs.metrics import forget_from
from pemirl_lab.runs.places import RunRefused
from pemirl_lab.runs.settings import Settings
from pemirl_lab.runs.validation import leaves
from pemirl_trl.checkpoint import TrainingCheckpoint
from pemirl_trl.files import atomic_path, content_digest
from pemirl_trl.methods import train
from pemirl_trl.methods.health_log import HealthLog
from pemirl_trl.methods.loop import Method, Metrics

FREE = ("threads", "device", "logger", "checkpoint_every", "confirm")
"""Settings that a run may be resumed with other values of: its results do not depend on them, or,
of the device, in their last digits alone."""


def _changed(previous: Mapping[str, Any], resolved: Mapping[str, Any]) -> list[str]:
    """Names of what is not as it was; of the library's settings, each by its own."""
    names = {k for k in resolved if k not in FREE and previous.get(k) != resolved[k]}
    before, now = (dict(leaves(of.get("settings") or {})) for of in (previous, resolved))
    own = {k for k in before.keys() | now.keys() if before.get(k) != now.get(k)}
    return sorted(names - {"settings"} | own)


class RunFolder:
    """Where a run writes, and how it shows its progress.

    A run that died resumes when the same command is given again: finished stages are read from
    their files, the stage at hand continues from its last checkpoint.

    Args:
        path: the folder.
        record: what the run is: its resolved configuration.
        logger: of the metrics: ``"csv"``, ``"tensorboard"`` or None.
        checkpoint_every: iterations.

    Raises:
        RunRefused: the folder holds a run of another configuration, or another process is at work
            in it.
    """

    def __init__(
        self,
        path: str | Path,
        record: Mapping[str, Any],
        *,
        logger: str | None,
        checkpoint_every: int,
    ) -> None:
        self.path = Path(path).expanduser()
        self.checkpoint_every = checkpoint_every
        self.seconds: dict[str, float] = {}
        self.standing = "it had not begun to train"
        self._lock = _lock(self.path)
        kept = {key: value for key, value in record.items() if key not in FREE}
        text = json.dumps(kept, sort_keys=True, default=str)
        self._identity = hashlib.sha256(text.encode()).hexdigest()
        self._claim(dict(record))
        self._kind = logger
        self._logger: Logger | None = get_logger(
            logger, logger_name=str(self.path), experiment_name="metrics"
        )

    @classmethod
    def of(cls, settings: Settings) -> RunFolder:
        """The folder that a command's settings name."""
        return cls(
            settings.run_dir,
            settings.resolved,
            logger=settings.logger,
            checkpoint_every=settings.checkpoint_every,
        )

    def _claim(self, resolved: dict[str, Any]) -> None:
        stored = self.path / "config.yaml"
        if stored.exists():
            previous = _read_yaml(stored)
            changed = _changed(previous, resolved)
            if changed and self._begun():
                raise RunRefused(
                    f"{self.path} holds a run with another {', '.join(changed)}: give another "
                    "run_dir, or delete that folder to start anew"
                )
        with atomic_path(stored) as temporary:
            temporary.write_text(yaml.safe_dump(resolved, sort_keys=False), encoding="utf-8")
        self.write_json("versions.json", environment_facts())

    def _begun(self) -> bool:
        """Whether an earlier process came to read or to make something here.

        One that was refused for a wrong name of a file has not, and does not block the right one.
        """
        return any(self.file(name).exists() for name in ("inputs.json", "seconds.json"))

    def release(self) -> None:
        """Let other processes have the folder."""
        self._lock.release()

    def file(self, name: str) -> Path:
        """A path inside the folder."""
        return self.path / name

    def write_json(self, name: str, content: Any) -> None:
        """Write a JSON file, atomically."""
        with atomic_path(self.path / name) as temporary:
            temporary.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")

    def reads(self, role: str, file: Path) -> Path:
        """Note that this run reads a file, or a folder of data, and return it.

        Raises:
            RunRefused: an earlier part of this run read another content under that role: what it
                made of it would not belong to what is made now.
        """
        inputs = read_json(self.path / "inputs.json")
        digest = content_digest(file)
        before = inputs.get(role)
        if before is not None and before["sha256"] != digest:
            raise RunRefused(
                f"{file} is not the {role} that the run in {self.path} began with (its content has "
                f"changed since; it was {before['file']}): give another run_dir, or delete that "
                "folder to start anew"
            )
        if before is None:
            inputs[role] = {"file": str(file), "sha256": digest}
            self.write_json("inputs.json", inputs)
        return file

    @contextlib.contextmanager
    def timed(self, stage: str) -> Iterator[Callable[[], None]]:
        """Measure a stage's wall-clock seconds, added up over resumptions.

        Yields what records them so far: a process that is killed does not come to the end.
        """
        before = read_seconds(self.path)
        start = time.perf_counter()

        def record() -> None:
            spent = time.perf_counter() - start
            self.seconds = {**before, stage: before.get(stage, 0.0) + spent}
            self.write_json("seconds.json", self.seconds)

        try:
            yield record
        finally:
            record()

    def train(self, stage: str, method: Method, show: str) -> list[tuple[int, float]]:
        """Train with checkpoints, logged metrics and a progress bar.

        Signs of failure are said above the bar when they begin and when they end, and all of them
        once more at the end.

        Args:
            stage: names the bar, the metrics and the checkpoints.
            method: what to train.
            show: the metric that matters, on the bar and in the curve. Where there is no ground
                truth, ``return/learned`` takes the place of ``return/true``.

        Returns:
            The learning curve: (environment steps, or iterations where there are none; ``show``).
        """
        curve: list[tuple[int, float]] = [(int(x), y) for x, y in read_curve(self.path, stage)]
        checkpoint = TrainingCheckpoint(
            self.path / "checkpoints" / stage, identity=f"{stage} of {self._identity}"
        )
        every = min(self.checkpoint_every, method.iterations)
        health = _health_log(self.path, stage)
        often = 0.1 if sys.stderr.isatty() else 30.0  # s; a file does not overwrite its lines
        bar = tqdm(
            total=method.iterations,
            desc=f"{stage:<14}",
            unit="it",
            file=sys.stderr,
            mininterval=often,
        )
        start, steps_at_start = time.perf_counter(), None

        def report(iteration: int, metrics: Metrics) -> None:
            nonlocal steps_at_start
            if steps_at_start is None:  # a resumed run: count this process's steps alone
                steps_at_start = method.env_steps * (iteration - 1) // iteration
                bar.update(iteration - 1)
                del curve[iteration - 1 :]
                if self._kind == "csv":  # what was logged after the checkpoint is logged anew
                    forget_from(iteration, self.path / "metrics" / "scalars" / stage)
            shown = show if show in metrics else "return/learned"
            curve.append((method.env_steps or iteration, metrics[shown]))
            rate = (method.env_steps - steps_at_start) / (time.perf_counter() - start)
            suffix = f", {rate:,.0f} env steps/s" if method.env_steps else ""
            bar.set_postfix_str(f"{shown} {metrics[shown]:.3f}{suffix}")
            bar.update()
            if self._logger is not None:
                for name, value in metrics.items():
                    self._logger.log_scalar(f"{stage}/{name}", value, step=iteration)
            health(iteration, metrics)
            self.standing = f"{stage} has done {iteration} of {method.iterations} iterations"
            if iteration % every == 0 or iteration == method.iterations:
                self.write_json(f"curves/{stage}.json", curve)
                health.save()
                record_seconds()

        with self.timed(stage) as record_seconds, bar, logging_redirect_tqdm():
            train(method, checkpoint=checkpoint, checkpoint_every=every, on_iteration=report)
        if health.health.iteration:
            say(f"{stage}: {health.health.summary()}")
        return curve


def _lock(folder: Path) -> FileLock:
    """Held until the process ends; this process may come back to its own folder."""
    folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder / ".lock", is_singleton=True)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise RunRefused(
            f"another process is at work in {folder}: wait for it, or give another run_dir"
        ) from None
    return lock


def _health_log(run: Path, stage: str) -> HealthLog:
    try:
        return HealthLog(stage, run / "health" / f"{stage}.json")
    except ValueError as error:
        raise RunRefused(str(error)) from error


def say(text: str) -> None:
    """Show the user a line or a table, below the progress bars."""
    tqdm.write(text)


# --- what a run left ---------------------------------------------------------------------------


def read_json(file: Path) -> dict[str, Any]:
    """A JSON object; empty where there is no file.

    Raises:
        RunRefused: the file holds something else.
    """
    if not file.exists():
        return {}
    content = _parsed(file)
    if not isinstance(content, dict):
        raise RunRefused(f"{file} holds a {type(content).__name__}; expected a JSON object")
    return content


def read_curve(run: Path, stage: str) -> list[list[float]]:
    """The learning curve of a stage; empty if the run has none.

    Raises:
        RunRefused: the file holds something else than pairs of numbers.
    """
    file = run / "curves" / f"{stage}.json"
    if not file.exists():
        return []
    points = _parsed(file)
    if not isinstance(points, list) or not all(
        isinstance(p, list) and len(p) == 2 and all(isinstance(x, int | float) for x in p)
        for p in points
    ):
        raise RunRefused(f"{file} is damaged: expected a list of [steps, value]")
    return points


def read_seconds(run: Path) -> dict[str, float]:
    """Wall-clock seconds of a run's stages.

    Raises:
        RunRefused: the file holds something else than numbers by stage.
    """
    seconds = read_json(run / "seconds.json")
    if not all(isinstance(value, int | float) and value >= 0 for value in seconds.values()):
        raise RunRefused(f"{run / 'seconds.json'} is damaged: expected seconds by stage")
    return seconds


def read_run(run: Path) -> dict[str, Any]:
    """What a run was: its configuration, less where it stood, and the versions it ran with."""
    stored = _read_yaml(run / "config.yaml")
    versions = read_json(run / "versions.json")
    return {k: v for k, v in stored.items() if k not in ("run_dir", "model_file")} | versions


def _parsed(file: Path) -> Any:
    try:
        return json.loads(file.read_text(encoding="utf-8"))
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise RunRefused(f"{file} is damaged: it is no JSON ({error})") from error


def _read_yaml(file: Path) -> dict[str, Any]:
    try:
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise RunRefused(f"{file} is damaged: it is no YAML ({error})") from error
    if not isinstance(content, dict):
        raise RunRefused(f"{file} is damaged: expected the configuration of a run")
    return content
