"""The metrics that TorchRL's CSV logger wrote: one row an iteration, also after a kill."""

from __future__ import annotations

from pathlib import Path

from pemirl_trl.files import atomic_path


def forget_from(iteration: int, folder: Path) -> None:
    """Drop rows of ``iteration`` and later, in all files below ``folder``: they come anew.

    Args:
        iteration: the first that is logged again.
        folder: of one stage; each file has lines ``step,value``.
    """
    for file in sorted(folder.rglob("*.csv")):
        lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
        kept = [line for line in lines if _step(line) < iteration]
        if len(kept) < len(lines):
            with atomic_path(file) as temporary:
                temporary.write_text("".join(kept), encoding="utf-8")


def _step(line: str) -> float:
    step = line.split(",", 1)[0].strip()
    # A line that a kill cut off has no newline and stands last: it is logged anew as well.
    return int(step) if step.isdigit() and line.endswith("\n") else float("inf")
