"""One folder per run: resolved configuration, versions, metrics, checkpoints, figures."""

from __future__ import annotations

import contextlib
import json
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import torch
from config import plain
from omegaconf import DictConfig, OmegaConf
from torchrl.record.loggers import Logger, get_logger
from tqdm import tqdm

from pemirl_trl.checkpoint import TrainingCheckpoint
from pemirl_trl.evaluation import environment_facts
from pemirl_trl.files import atomic_path
from pemirl_trl.methods import train
from pemirl_trl.methods.loop import Method, Metrics


class RunFolder:
    """Where a run writes, and how it shows its progress.

    A run that died resumes when the same command is given again: finished stages are read from
    their files, the stage at hand continues from its last checkpoint.

    Args:
        config: resolved; has ``run_dir``, ``seed``, ``logger`` and ``checkpoint_every``.

    Raises:
        ValueError: the folder holds a run of another configuration.
    """

    def __init__(self, config: DictConfig) -> None:
        self.config = config
        self.path = Path(config.run_dir)
        self.seconds: dict[str, float] = {}
        self._claim(plain(config))
        # One thread: sums of floats depend on how many share them, so this makes a run's results
        # those of its seed, whatever ``threads`` gives the simulator. More would gain little here,
        # and on a busy machine they spin.
        torch.set_num_threads(1)
        self._logger: Logger | None = get_logger(
            config.logger, logger_name=str(self.path), experiment_name="metrics"
        )

    def _claim(self, resolved: dict[str, Any]) -> None:
        self.path.mkdir(parents=True, exist_ok=True)
        stored = self.path / "config.yaml"
        if stored.exists():
            previous = plain(OmegaConf.create(OmegaConf.load(stored)))  # type: ignore[arg-type]
            changed = sorted(k for k in resolved if previous.get(k) != resolved[k])
            if changed:
                raise ValueError(
                    f"{self.path} holds a run with another {', '.join(changed)}: give another "
                    "run_dir, or delete that folder to start anew"
                )
        with atomic_path(stored) as temporary:
            OmegaConf.save(OmegaConf.create(resolved), temporary)
        self.write_json("versions.json", environment_facts())

    def file(self, name: str) -> Path:
        """A path inside the folder."""
        return self.path / name

    def write_json(self, name: str, content: Any) -> None:
        """Write a JSON file, atomically."""
        with atomic_path(self.path / name) as temporary:
            temporary.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")

    @contextlib.contextmanager
    def timed(self, stage: str) -> Iterator[Callable[[], None]]:
        """Measure a stage's wall-clock seconds, added up over resumptions.

        Yields what records them so far: a process that is killed does not come to the end.
        """
        file = self.path / "seconds.json"
        before = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
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

        Args:
            stage: names the bar, the metrics and the checkpoints.
            method: what to train.
            show: the metric that matters, on the bar and in the curve.

        Returns:
            The learning curve: (environment steps, or iterations where there are none; ``show``).
        """
        curve_file = self.path / "curves" / f"{stage}.json"
        curve: list[tuple[int, float]] = []
        if curve_file.exists():
            curve = [tuple(point) for point in json.loads(curve_file.read_text(encoding="utf-8"))]
        checkpoint = TrainingCheckpoint(self.path / "checkpoints" / stage)
        every = min(self.config.checkpoint_every, method.iterations)
        bar = tqdm(total=method.iterations, desc=f"{stage:<14}", unit="it", file=sys.stderr)
        start, steps_at_start = time.perf_counter(), None

        def report(iteration: int, metrics: Metrics) -> None:
            nonlocal steps_at_start
            if steps_at_start is None:  # a resumed run: count this process's steps alone
                steps_at_start = method.env_steps * (iteration - 1) // iteration
                bar.update(iteration - 1)
                del curve[iteration - 1 :]
            curve.append((method.env_steps or iteration, metrics[show]))
            rate = (method.env_steps - steps_at_start) / (time.perf_counter() - start)
            suffix = f", {rate:,.0f} env steps/s" if method.env_steps else ""
            bar.set_postfix_str(f"{show} {metrics[show]:.3f}{suffix}")
            bar.update()
            if self._logger is not None:
                for name, value in metrics.items():
                    self._logger.log_scalar(f"{stage}/{name}", value, step=iteration)
            if iteration % every == 0 or iteration == method.iterations:
                self.write_json(f"curves/{stage}.json", curve)
                record_seconds()

        with self.timed(stage) as record_seconds, bar:
            train(method, checkpoint=checkpoint, checkpoint_every=every, on_iteration=report)
        return curve


def say(text: str) -> None:
    """Show the user a line or a table, below the progress bars."""
    tqdm.write(text)
