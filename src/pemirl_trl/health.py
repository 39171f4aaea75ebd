"""Signs of failure in the metrics of a training, each with its cure.

A sign is a function of the metrics so far and a threshold; it begins where the threshold was
crossed in each of the last iterations, and ends in the same way. Nothing here knows how a
training is made: a trainer of one's own calls :meth:`Health.update` with the same names.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

Row = Mapping[str, float]
Measure = Callable[[Sequence[Row], Sequence[str]], float | None]
"""Of the rows so far, of which the last is now, and of names; None where it cannot be told."""


@dataclass(frozen=True)
class Sign:
    """One way in which a training fails.

    Attributes:
        name: in two or three words.
        meaning: what is wrong, as a clause.
        measured: what is compared with the threshold.
        reads: names of the metrics; where they are the same thing under several names, the first
            that is there counts.
        measure: of the rows and these names.
        threshold: from which on it counts.
        above: whether larger values are the bad ones.
        patience: iterations in a row that it takes to begin, and to end.
        cure: what to do, by the names of the settings.
    """

    name: str
    meaning: str
    measured: str
    reads: tuple[str, ...]
    measure: Measure
    threshold: float
    above: bool
    patience: int
    cure: str

    @property
    def limit(self) -> str:
        """The threshold with its side, for people: ``"above 0.97"``."""
        return f"{'above' if self.above else 'below'} {self.threshold:g}"

    def present(self, rows: Sequence[Row]) -> tuple[bool, float] | None:
        """Whether the last row shows it, and what was measured; a NaN does."""
        value = self.measure(rows, self.reads)
        if value is None:
            return None
        sound = value <= self.threshold if self.above else value >= self.threshold
        return not sound, value


@dataclass(frozen=True)
class Finding:
    """A sign that appeared.

    Attributes:
        sign: which.
        since: the first iteration that showed it.
        value: what was measured when it was noticed.
        until: the last iteration that showed it; None while it lasts.
    """

    sign: Sign
    since: int
    value: float
    until: int | None = None

    def __str__(self) -> str:
        """Return one line: what, since when, what was measured, and the cure; or that it ended."""
        sign = self.sign
        if self.until is not None:
            return f"no longer: {sign.name} (iterations {self.since} to {self.until})"
        return (
            f"{sign.name} since iteration {self.since}: {sign.meaning} ({sign.measured} "
            f"{self.value:.3g}; a sign {sign.limit}). Cure: {sign.cure}"
        )


class Health:
    """Watches the metrics of a training, one call an iteration.

    What it finds depends on the metrics alone: after an interruption, the rows of before give the
    same state again.

    Args:
        signs: to look for.

    Attributes:
        findings: all so far, in the order in which they were noticed.

    Example:
        >>> health = Health()
        >>> for _ in range(30):
        ...     for finding in health.update({"reward/accuracy": 1.0}):
        ...         print(finding.sign.name, "since", finding.since)
        discriminator saturated since 1
    """

    def __init__(self, signs: Iterable[Sign] | None = None) -> None:
        self.signs = tuple(SIGNS if signs is None else signs)
        self.findings: list[Finding] = []
        self.iteration = 0
        self._rows: list[Row] = []
        self._streaks = {sign.name: (0, 0) for sign in self.signs}  # length, first iteration

    def update(self, metrics: Row, iteration: int | None = None) -> list[Finding]:
        """Take the metrics of one iteration.

        Args:
            metrics: by name; those that no sign reads are ignored, and a sign whose metric is
                missing is not judged.
            iteration: its number, from 1; None counts the calls.

        Returns:
            What began or ended now; what goes on is not said again.

        Raises:
            ValueError: the iteration does not come after the last one.
        """
        now = self.iteration + 1 if iteration is None else iteration
        if now <= self.iteration:
            raise ValueError(f"got iteration {now} after {self.iteration}; expected a later one")
        self.iteration = now
        self._rows.append({name: float(value) for name, value in metrics.items()})
        news = [self._judge(sign) for sign in self.signs]
        return [finding for finding in news if finding is not None]

    def _judge(self, sign: Sign) -> Finding | None:
        judged = sign.present(self._rows)
        if judged is None:
            return None
        present, value = judged
        lasting = self._lasting(sign)
        if present == (lasting is not None):  # nothing new
            self._streaks[sign.name] = (0, 0)
            return None
        length, first = self._streaks[sign.name]
        length, first = length + 1, first if length else self.iteration
        self._streaks[sign.name] = (length, first)
        if length < sign.patience:
            return None
        self._streaks[sign.name] = (0, 0)
        if lasting is None:
            found = Finding(sign, first, value)
            self.findings.append(found)
            return found
        ended = replace(lasting, until=first - 1)
        self.findings[self.findings.index(lasting)] = ended
        return ended

    def _lasting(self, sign: Sign) -> Finding | None:
        mine = (f for f in self.findings if f.sign is sign and f.until is None)
        return next(mine, None)

    def summary(self) -> str:
        """Return a table of what was found, in Markdown, or that there was nothing."""
        if not self.findings:
            return f"no sign of failure in {self.iteration} iterations"
        lines = [
            "| sign | iterations | measured | a sign | cure |",
            "| --- | --- | --- | --- | --- |",
        ]
        for f in self.findings:
            end = "the end" if f.until is None else f.until
            value = f"{f.sign.measured} {f.value:.3g}"
            cells = (f.sign.name, f"{f.since} to {end}", value, f.sign.limit, f.sign.cure)
            lines.append(f"| {' | '.join(cells)} |")
        return "\n".join(lines)


# --- what is measured --------------------------------------------------------------------------

_WINDOW = 5
"""Iterations over which a noisy metric is averaged."""


def _mean(rows: Sequence[Row], name: str, over: int) -> float:
    values = [row[name] for row in rows[-over:] if name in row]
    return sum(values) / len(values)


def latest(rows: Sequence[Row], names: Sequence[str]) -> float | None:
    """The metric of now: the first of the names that is there."""
    return next((rows[-1][name] for name in names if name in rows[-1]), None)


def recent(rows: Sequence[Row], names: Sequence[str]) -> float | None:
    """The same, as a mean over the last iterations."""
    name = next((name for name in names if name in rows[-1]), None)
    return None if name is None else _mean(rows, name, _WINDOW)


def growth(rows: Sequence[Row], names: Sequence[str]) -> float | None:
    """A metric as a multiple of what it was at first."""
    (name,) = names
    first = next((row[name] for row in rows if name in row), None)
    if name not in rows[-1] or first is None or not first > 0:
        return None
    return rows[-1][name] / first


def missed(rows: Sequence[Row], names: Sequence[str]) -> float | None:
    """The share of the last iterations in which a metric that is 0 or 1 was 0."""
    (name,) = names
    return None if name not in rows[-1] else 1.0 - _mean(rows, name, 2 * _WINDOW)


def way_to_go(rows: Sequence[Row], names: Sequence[str]) -> float | None:
    """How much of the way from the first return to the best trajectories is still to go."""
    best, own = names
    if not {best, own} <= rows[-1].keys():
        return None
    first = next(row[own] for row in rows if own in row)
    way = rows[-1][best] - first
    return (rows[-1][best] - _mean(rows, own, _WINDOW)) / way if way > 0 else 0.0


SIGNS: tuple[Sign, ...] = (
    Sign(
        name="discriminator saturated",
        meaning="it tells expert from policy without fail, so that r no longer says what is better",
        measured="accuracy",
        reads=("reward/accuracy", "discriminator/accuracy", "accuracy"),
        measure=recent,
        threshold=0.97,
        above=True,
        patience=10,
        cure="let r learn less (training.reward_steps, training.reward_lr), blur and penalise it "
        "(method=pemirl_robust), or start the policy from Meta-IL (initial_policy=meta_il)",
    ),
    Sign(
        name="discriminator behind",
        meaning="it classifies worse than a coin (0.69): r chases a constant, such as log pi's",
        measured="loss",
        reads=(
            *("reward/loss_discriminator", "discriminator/loss_discriminator"),
            "loss_discriminator",
        ),
        measure=recent,
        threshold=1.5,
        above=True,
        patience=5,
        cure="training.batch.relative_log_prob=true, or more of training.reward_steps",
    ),
    Sign(
        name="posterior collapsed",
        meaning="q is nearly the same for all demonstrations",
        measured="nats that m tells about its demonstration",
        reads=("context/information", "meta_il/kl"),
        measure=latest,
        threshold=0.5,
        above=False,
        patience=5,
        cure="a smaller meta_il.kl_coeff (the evidence bound's own is 1 / T), more of "
        "meta_il.steps, and initial_encoder=meta_il",
    ),
    Sign(
        name="context ignored",
        meaning="r is the same whatever m is, so that no task is told from another",
        measured="share of r's variance that m explains",
        reads=("context/in_reward",),
        measure=recent,
        threshold=0.02,
        above=False,
        patience=10,
        cure="look at q first (posterior collapsed?); then negatives under a wrong m "
        "(training.batch.mismatched_fraction=0.5), or more of training.info_coeff",
    ),
    Sign(
        name="r exploding",
        meaning="the reward grows without end",
        measured="mean magnitude of r, in nats",
        reads=("reward/magnitude",),
        measure=latest,
        threshold=20.0,
        above=True,
        patience=5,
        cure="training.gradient_penalty_coeff=0.1, less of training.info_coeff, or the bounded "
        "information term (method=pemirl)",
    ),
    Sign(
        name="deviation runaway",
        meaning="the policy acts ever more at random",
        measured="learned deviation, as a multiple of the first",
        reads=("policy/learned_scale",),
        measure=growth,
        threshold=1.5,
        above=True,
        patience=5,
        cure="training.policy.trpo.entropy_coeff=0 (actions that are clamped make entropy free), "
        "or a forced deviation (training.policy.final_scale)",
    ),
    Sign(
        name="line search failing",
        meaning="the policy hardly moves: its steps are refused",
        measured="share of steps refused",
        reads=("trpo/accepted",),
        measure=missed,
        threshold=0.5,
        above=True,
        patience=5,
        cure="a smaller trpo.max_kl, more of trpo.damping or trpo.fisher_rows, or more rollouts",
    ),
    Sign(
        name="policy far below its best",
        meaning="far better trajectories were found than the policy makes: the optimiser fails, "
        "not r",
        measured="share of the way that is still to go",
        reads=("best/return", "return/learned"),
        measure=way_to_go,
        threshold=0.5,
        above=True,
        patience=25,
        cure="more of optimization.iterations or optimization.trpo.max_kl, or a deviation that "
        "shrinks later or further (optimization.final_scale)",
    ),
    Sign(
        name="r high outside",
        meaning="the policy earns more than the demonstrator where none ever was: r means nothing "
        "there",
        measured="share of such steps",
        reads=("outside/rewarded",),
        measure=recent,
        threshold=0.05,
        above=True,
        patience=5,
        cure="negatives from farther off (training.batch.jitter_scale) and a penalty "
        "(training.gradient_penalty_coeff): method=pemirl_robust; or more varied demonstrations",
    ),
)
"""All signs, in the order of the pages."""
