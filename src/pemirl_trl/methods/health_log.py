"""Says the signs of failure of a stage as they come, once each, also after a kill."""

from __future__ import annotations

import json
import logging
from pathlib import Path

from pemirl_trl.files import atomic_path
from pemirl_trl.health import Health
from pemirl_trl.methods.loop import Metrics

LOG = logging.getLogger("pemirl_trl.health")


class HealthLog:
    """A stage's metrics and what is wrong with them: a warning when a sign begins or ends.

    Args:
        stage: what the lines call it.
        file: keeps the metrics of each iteration and the lines that were said; None keeps them in
            memory. A training that resumes from a checkpoint goes through its iterations of before
            in silence, and repeats no line.

    Raises:
        ValueError: the file holds something else.
    """

    def __init__(self, stage: str, file: Path | None = None) -> None:
        self.stage, self.file = stage, file
        self.health = Health()
        self.rows: list[tuple[int, Metrics]] = []
        self.said: list[str] = []
        self._resumed = False
        if file is not None and file.exists():
            self.rows, self.said = read_health(file)

    def __call__(self, iteration: int, metrics: Metrics) -> None:
        """Take the metrics of an iteration, and say what is new."""
        if not self._resumed:
            self._resumed = True
            self.rows = [row for row in self.rows if row[0] < iteration]
            for before, row in self.rows:
                self.health.update(row, before)
        self.rows.append((iteration, dict(metrics)))
        lines = [str(finding) for finding in self.health.update(metrics, iteration)]
        new = [line for line in lines if line not in self.said]
        for line in new:
            LOG.warning("%s, iteration %d: %s", self.stage, iteration, line)
        self.said += new
        if new:
            self.save()

    def save(self) -> None:
        """Write the file; to be called before each checkpoint."""
        if self.file is None:
            return
        content = {"rows": [[i, row] for i, row in self.rows], "said": self.said}
        with atomic_path(self.file) as temporary:
            temporary.write_text(json.dumps(content) + "\n", encoding="utf-8")


def read_health(file: Path) -> tuple[list[tuple[int, Metrics]], list[str]]:
    """The metrics ``(iteration, row)`` and the lines that a :class:`HealthLog` kept.

    Raises:
        ValueError: the file holds something else.
    """
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
        rows = [
            (int(iteration), {str(name): float(value) for name, value in row.items()})
            for iteration, row in content["rows"]
        ]
        return rows, [str(line) for line in content["said"]]
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{file} is damaged: expected the metrics of a stage ({error})") from error


def replayed(rows: list[tuple[int, Metrics]]) -> Health:
    """The health of a stage, from its metrics."""
    health = Health()
    for iteration, row in rows:
        health.update(row, iteration)
    return health
