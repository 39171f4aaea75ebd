"""Signs of failure: oracle histories, once-only lines, resumption, and trainings that were run."""

import json
import math
from pathlib import Path

import pytest

from pemirl_lab.pages.health_tables import judged
from pemirl_trl import Health
from pemirl_trl.health import SIGNS

ROOT = Path(__file__).parents[1]
CASES = sorted((ROOT / "results/health").glob("*.json"))
BY_NAME = {sign.name: sign for sign in SIGNS}
START = 4  # iterations that are well

# What each sign reads, first of a training that is well, then as a function of how far beyond the
# threshold it is: written out by hand, beside the table.
HISTORIES = {
    "discriminator saturated": ({"reward/accuracy": 0.7}, lambda d: {"reward/accuracy": 0.97 + d}),
    "discriminator behind": (
        {"reward/loss_discriminator": 0.69},
        lambda d: {"reward/loss_discriminator": 1.5 + d},
    ),
    "posterior collapsed": (
        {"context/information": 3.0},
        lambda d: {"context/information": 0.5 - d},
    ),
    "context ignored": ({"context/in_reward": 0.8}, lambda d: {"context/in_reward": 0.02 - d}),
    "r exploding": ({"reward/magnitude": 2.0}, lambda d: {"reward/magnitude": 20.0 + d}),
    "deviation runaway": (
        {"policy/learned_scale": 0.6},
        lambda d: {"policy/learned_scale": 0.6 * (1.5 + d)},
    ),
    "policy far below its best": (
        {"best/return": 100.0, "return/learned": 0.0},  # the way is 100; half of it is 50
        lambda d: {"best/return": 100.0, "return/learned": 100.0 * (0.5 - d)},
    ),
    "r high outside": ({"outside/rewarded": 0.0}, lambda d: {"outside/rewarded": 0.05 + d}),
}


def found(history):
    """The names of what begins in a history, by iteration."""
    health = Health()
    return [
        (health.iteration, finding.sign.name) for row in history for finding in health.update(row)
    ]


def test_every_sign_has_a_history():
    assert set(HISTORIES) | {"line search failing"} == set(BY_NAME)


@pytest.mark.parametrize("name", HISTORIES)
def test_a_sign_begins_beyond_its_threshold_and_not_before(name):
    well, at = HISTORIES[name]
    # The way to the best starts off unfinished: no iteration of before counts as well there.
    before = [well] if name in ("deviation runaway", "policy far below its best") else []
    long = BY_NAME[name].patience + 10
    beyond, within = ([*before, *[at(d)] * long] for d in (1e-3, -1e-3))
    assert [sign for _, sign in found(beyond)] == [name]
    assert name not in [sign for _, sign in found(within)]


def test_line_search_counts_the_share_of_refusals():
    half = [{"trpo/accepted": float(i % 2)} for i in range(40)]
    assert found(half) == []
    mostly = [{"trpo/accepted": float(i % 3 == 0)} for i in range(40)]
    assert [sign for _, sign in found(mostly)] == ["line search failing"]


def test_patience_decides_when_and_a_break_starts_anew():
    sign = BY_NAME["r exploding"]
    sick, well = {"reward/magnitude": 1e3}, {"reward/magnitude": 1.0}
    assert found([sick] * (sign.patience - 1)) == []
    assert found([sick] * sign.patience) == [(sign.patience, sign.name)]
    broken = [*[sick] * (sign.patience - 1), well, *[sick] * (sign.patience - 1)]
    assert found(broken) == []


def test_a_sign_is_said_when_it_begins_and_when_it_ends_and_not_between():
    sign, health, lines = BY_NAME["r exploding"], Health(), []
    sick, well = {"reward/magnitude": 1e3}, {"reward/magnitude": 1.0}
    for row in [well] * START + [sick] * 20 + [well] * 20:
        lines += [(health.iteration, str(finding)) for finding in health.update(row)]
    assert [iteration for iteration, _ in lines] == [START + sign.patience, 24 + sign.patience]
    assert lines[0][1].startswith(f"r exploding since iteration {START + 1}: the reward grows")
    assert "1e+03; a sign above 20" in lines[0][1]
    assert sign.cure in lines[0][1]
    assert lines[1][1] == f"no longer: r exploding (iterations {START + 1} to 24)"
    assert f"| r exploding | {START + 1} to 24 |" in health.summary()


def test_a_sign_may_come_back():
    sick, well = {"reward/magnitude": 1e3}, {"reward/magnitude": 1.0}
    health = Health()
    for row in ([sick] * 10 + [well] * 10) * 2:
        health.update(row)
    assert [(f.since, f.until) for f in health.findings] == [(1, 10), (21, 30)]


def test_nan_is_a_sign_and_what_is_missing_is_not_judged():
    assert [sign for _, sign in found([{"reward/magnitude": math.nan}] * 10)] == ["r exploding"]
    assert found([{}] * 50) == []
    assert Health().summary() == "no sign of failure in 0 iterations"


def test_names_of_other_trainers_count():
    for name in ("accuracy", "discriminator/accuracy"):
        assert [sign for _, sign in found([{name: 1.0}] * 20)] == ["discriminator saturated"]


def test_iterations_come_in_order():
    health = Health()
    health.update({}, 3)
    with pytest.raises(ValueError, match="got iteration 3 after 3"):
        health.update({}, 3)


def test_every_cure_names_settings_that_there_are():
    """Dotted names of settings in the cures, looked up in the library's configurations."""
    import dataclasses
    import re

    from pemirl_trl.methods import METHODS, AdaptationConfig

    known = {"trpo": METHODS["pemirl"].training.policy.trpo}
    roots = [*METHODS.values(), AdaptationConfig()]
    for sign in SIGNS:
        for path in re.findall(r"\b[a-z_]+(?:\.[a-z_]+)+\b", sign.cure):
            nodes = [known, *roots]
            for part in path.split("."):
                nodes = [_child(node, part) for node in nodes]
                nodes = [node for node in nodes if node is not _ABSENT]
            assert nodes, f"{sign.name}: no setting {path}"
    assert dataclasses.is_dataclass(roots[0])


_ABSENT = object()


def _child(node, name):
    if isinstance(node, dict):
        return node.get(name, _ABSENT)
    return getattr(node, name, _ABSENT)


@pytest.mark.parametrize("file", CASES, ids=lambda file: file.stem)
def test_trainings_that_were_run_show_what_is_expected_and_no_more(file):
    record = json.loads(file.read_text("utf-8"))
    said = {finding.sign.name for finding in judged(record)}
    if record["expected"]:
        assert set(record["expected"]) <= said
    else:
        assert said == set()


def test_there_are_healthy_and_sick_trainings_and_most_signs_were_seen():
    records = [json.loads(file.read_text("utf-8")) for file in CASES]
    assert sum(not record["expected"] for record in records) >= 5
    seen = {name for record in records for name in record["expected"]}
    assert seen <= set(BY_NAME)
    assert len(seen) >= 6
