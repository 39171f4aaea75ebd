"""Every value of a command, made wrong in every way of its kind, is refused by its whole name."""

import copy
import math

import pytest

from pemirl_lab.cli import COMMANDS
from pemirl_lab.commands import quickstart, reproduce
from pemirl_lab.runs.composition import compose, plain
from pemirl_lab.runs.settings import parse
from pemirl_lab.runs.tables import read_table

WRONG = {
    bool: ["maybe", 2, [True], None, math.nan],
    int: ["abc", "", 1.5, True, -1, 10**12, math.nan, math.inf, [1], {"a": 1}],
    float: ["abc", "", -1.0, math.nan, math.inf, -math.inf, [1.0], {"a": 1}],
    str: [3, None, [], {"a": 1}, True],
}
"""By the type of the right value: what can never take its place."""
MAY_BE_NEGATIVE = ("low", "high")
MAY_BE_NOTHING = ("output", "expert", "logger", "init")
CHOICES = (
    "algorithm", "model.encoder", "model.reward", "initial_encoder", "initial_policy",
    "reward_reads", "training.policy_reward", "training.info_summand", "training.info_form",
    "training.policy.trpo.standardize", "training.batch.negative_log_prob", "logger",
    "info_estimator", "adaptation.initial_policy", "adaptation.policy_activation",
    "expert_training.policy.activation", "environment", "test_environment",
)  # fmt: skip


def configurations():
    yield "quickstart", plain(compose("quickstart")), quickstart.Own
    yield "quickstart", plain(compose("quickstart", ["experiment=ant"])), quickstart.Own
    yield "quickstart", plain(compose("quickstart", ["~experiment", "method=airl"])), quickstart.Own
    row = read_table("sweeper").compose("pemirl_contrastive")
    yield "reproduce", row, reproduce.Own


def paths(node, path=()):
    """Every value that is no group, by the keys that lead to it: a key may hold a dot."""
    for key, value in node.items():
        if isinstance(value, dict) and value:
            yield from paths(value, (*path, key))
        else:
            yield (*path, key), value


def changed(resolved, where, value):
    """``resolved`` with another value, as Hydra's command line would set it."""
    values = copy.deepcopy(resolved)
    *path, last = where
    node = values
    for key in path:
        node = node[key]
    node[last] = value
    return values


def wrong_values(name, value):
    if name in CHOICES:
        yield "anything"
    for bad in WRONG.get(type(value), []):
        negative = isinstance(bad, float | int) and bad < 0
        if negative and name.rsplit(".", 1)[-1] in MAY_BE_NEGATIVE:
            continue
        if bad == 10**12 and name.rsplit(".", 1)[-1] == "seed":
            continue
        if bad is None and name.rsplit(".", 1)[-1] in MAY_BE_NOTHING:
            continue
        yield bad


def test_wrong_values_are_refused_by_name():
    tried, wrongly, unnamed = 0, [], []
    for command, resolved, own in configurations():
        assert command in COMMANDS
        parse(resolved, own)  # as it is, it is right
        for where, value in paths(resolved):
            name = ".".join(where)
            for bad in wrong_values(name, value):
                tried += 1
                try:
                    parse(changed(resolved, where, bad), own)
                except ValueError as error:
                    if where[-1] not in str(error):
                        unnamed.append((command, name, bad, str(error)))
                else:
                    wrongly.append((command, name, bad))
    print(f"overrides: {tried} tried, {tried - len(wrongly) - len(unnamed)} refused by name")
    assert tried > 1000
    assert wrongly == []
    assert unnamed == []


@pytest.mark.parametrize("where", ["training", "training.policy.trpo", "meta_il", "model"])
def test_unknown_names_are_refused(where):
    resolved = plain(compose("quickstart"))
    with pytest.raises(ValueError, match=rf"unknown key {where}\.typo"):
        parse(changed(resolved, (*where.split("."), "typo"), 1), quickstart.Own)
    with pytest.raises(ValueError, match="unknown keys typo"):
        parse({**resolved, "typo": 1}, quickstart.Own)


@pytest.mark.parametrize("where", ["training", "meta_il", "evaluation", "adaptation", "experts"])
def test_a_number_where_a_group_of_values_is_meant_is_refused(where):
    with pytest.raises(ValueError, match=where):
        parse(changed(plain(compose("quickstart")), (where,), 3), quickstart.Own)
