"""The reward report as Markdown and as one HTML file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from pemirl_lab.measuring.candidates import Candidate
from pemirl_lab.pages import html
from pemirl_lab.pages.figures import measures_of_tasks
from pemirl_trl import DemonstrationDataset
from pemirl_trl.evaluation import RewardReport

EXPLAINED = (
    "Spearman, Pearson: correlation with the true reward, shaping and all; 1 is perfect.",
    "EPIC (Gleave et al., ICLR 2021): 0 where the two rewards differ by scale, constant and "
    "potential shaping alone, about 0.71 for unrelated ones, 1 for opposite ones. It asks for "
    "rewards of transitions that the dynamics do not allow.",
    "feasible distance (after Skalse et al., ICLR 2024): the same scale, from the transitions that "
    "happened alone; shaping is taken out by regression on {features} radial functions.",
    "argmax error: from the map's maximum to the goal.",
)


@dataclass(frozen=True)
class RewardPage:
    """What there is to tell of a reward.

    Attributes:
        candidate: what was measured.
        report: its measures.
        demonstrations: one of each task.
        environment: under whose dynamics.
        coverage: each coverage distribution, in words.
        features: radial functions of the feasible distance.
        figures: file name to a drawing and its caption.
        returns: true returns of new policies, by where they were trained; empty: none were.
    """

    candidate: Candidate
    report: RewardReport
    demonstrations: DemonstrationDataset
    environment: str
    coverage: Mapping[str, str]
    features: int
    figures: Mapping[str, tuple[Figure, str]]
    returns: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def content(self) -> dict[str, Any]:
        """The numbers, as JSON has them."""
        report = self.report
        return {
            "reward": self.candidate.name,
            "environment": self.environment,
            "summary": report.summary(),
            "per_task": {"/".join(m): values.tolist() for m, values in report.per_task.items()},
            "tasks": {k: v.tolist() for k, v in self.demonstrations.tasks().items()},
            "returns": self.returns,
        }

    def markdown(self) -> str:
        """The page for a text reader; its figures are files beside it."""
        lines = [
            *("# Reward report", "", self._introduction(), "", self.report.markdown()),
            *(f"- *{name}*: {text}" for name, text in self.coverage.items()),
            *("", *(f"- {text}" for text in self._explained()), ""),
            *(f"![{caption}](figures/{name})\n" for name, (_, caption) in self.figures.items()),
        ]
        if self.returns:
            head, rows = self._returns()
            lines += [self._transfer(), "", f"| {' | '.join(head)} |"]
            lines += [f"| {' | '.join(['---'] * len(head))} |"]
            lines += [f"| {' | '.join(row)} |" for row in rows]
        return "\n".join(lines) + "\n"

    def write_html(self, file: Path) -> None:
        """Write one file that needs no other."""
        head, *rows = self.report.table()
        captioned = [html.figure(drawn, caption) for drawn, caption in self.figures.values()]
        each = html.figure(
            measures_of_tasks(self.report.by_metric()),
            "Each dot is a task; black: the mean over tasks.",
        )
        parts = [
            html.paragraph(self._introduction()),
            html.section("Measures", [html.table(head, rows), each]),
            html.section("Figures", captioned),
            html.section("Measured on", [html.facts(self.coverage)]),
            html.section("What the columns mean", map(html.paragraph, self._explained())),
        ]
        if self.returns:
            transfer = [html.paragraph(self._transfer()), html.table(*self._returns())]
            parts.insert(2, html.section("New policies", transfer))
        if self.candidate.card is not None:
            card = self.candidate.card
            known = {"domain": card.domain, "licence": card.licence, "made by": card.command}
            parts.append(html.section("The reward's card", [html.facts(known)]))
        html.write_page(file, f"Reward report: {self.candidate.name}", parts)

    def _introduction(self) -> str:
        sentences = [
            f"`{self.candidate.name}`, {len(self.demonstrations)} tasks, measured under the "
            f"dynamics of `{self.environment}`.",
            f"r: the reward r(s, m); m is {self.candidate.context_is}.",
        ]
        if "f" in self.candidate.rewards:
            sentences.append("f: with its potential, f = r + gamma h(s') - h(s).")
        return " ".join([*sentences, "Means over tasks, the worst task in parentheses."])

    def _explained(self) -> list[str]:
        return [text.format(features=self.features) for text in EXPLAINED]

    def _transfer(self) -> str:
        return "True returns, means over tasks, of new policies trained on r:"

    def _returns(self) -> tuple[list[str], Sequence[Sequence[str]]]:
        columns = list(next(iter(self.returns.values())))
        rows = [[kind, *(f"{v:.2f}" for v in r.values())] for kind, r in self.returns.items()]
        return ["", *columns], rows
