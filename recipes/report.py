"""The tables of the README, from the results files.

python recipes/report.py                  # print
python recipes/report.py --write          # and put it between the README's markers
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from pemirl_trl.checkpoint import atomic_path
from pemirl_trl.evaluation import Result, read, table

ROOT = Path(__file__).resolve().parent.parent
BEGIN, END = "<!-- results:begin -->", "<!-- results:end -->"

PAPER = """\
| paper (Yu et al., 2019) | random | expert | Meta-IL | PEMIRL |
| --- | --- | --- | --- | --- |
| one-shot, left | -51.39 | -5.21 | -6.68 (0.968) | -7.37 (0.953) |
| policy generalisation, right | – | -5.37 | -28.61 | -28.93 |
| reward adaptation, right, goals with x in [0.1, 0.4] | – | -5.37 | – | -9.04 |
"""
"""Tables 1 and 2 of the paper, for Point-Maze."""


def report(results: list[Result]) -> str:
    """Markdown: our table, its facts, and the paper's numbers."""
    seeds = sorted({result.seed for result in results})
    one = results[0]
    steps = {
        (result.method, name): count
        for result in results
        for name, count in result.env_steps.items()
        if count
    }
    spent = "; ".join(
        f"{method} {count / 1e6:.1f}M of {name.replace('_', '-')}"
        for (method, name), count in sorted(steps.items())
    )
    commits = sorted({_short(result.commit) for result in results})
    return (
        "True returns of the last policy over unseen tasks, one demonstration each, "
        f"seeds {', '.join(map(str, seeds))}: mean (normalised) [every seed].\n\n"
        f"{table(results)}\n"
        f"Environment steps: {spent}. {one.hardware['cpus']} CPUs ({one.hardware['cpu']}), torch "
        f"{one.versions['torch']}, TorchRL {one.versions['torchrl']}, MuJoCo "
        f"{one.versions['mujoco']}, commit {', '.join(commits)}.\n\n"
        f"{PAPER}"
    )


def _short(commit: str) -> str:
    return commit[:12] + ("-dirty" if commit.endswith("-dirty") else "")


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--results", type=Path, default=ROOT / "results/point_maze", help="folder of files"
    )
    parser.add_argument("--write", action="store_true", help="put it into README.md")
    arguments = parser.parse_args()
    files = sorted(arguments.results.rglob("*.json"))
    if not files:
        sys.exit(f"no results below {arguments.results}; recipes/quickstart.py writes some")
    text = report([read(file) for file in files])
    sys.stdout.write(text)
    if arguments.write:
        readme = ROOT / "README.md"
        page = readme.read_text(encoding="utf-8")
        before, after = page.split(BEGIN)[0], page.split(END)[1]
        with atomic_path(readme) as temporary:
            temporary.write_text(f"{before}{BEGIN}\n{text}{END}{after}", encoding="utf-8")


if __name__ == "__main__":
    main()
