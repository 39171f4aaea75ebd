"""The share of a gap that adaptation closes; every number is worked out by hand."""

import pytest

from pemirl_lab.pages.gap import best_known, gap_closed, gap_table
from pemirl_lab.results import Result, Score


def score(mean, setting, *, variant="right", goals="all", expert=-5.0):
    return Score(
        setting=setting,
        variant=variant,
        goals=goals,
        per_task=(mean,),
        random=-45.0,
        expert=expert,
        env_steps={"meta_training": 1, "adaptation": 0},
    )


def result(row, seed, *scores):
    facts = {"table": "maze", "task": "maze", "split": "test", "commit": "abc"}
    none = {"seconds": {"a": 1.0}, "config": {}, "versions": {}, "hardware": {}}
    return Result(row=row, seed=seed, scores=scores, **facts, **none)


def adapted(row, seed, carried, new, **where):
    settings = {"policy_generalisation": carried, "reward_adaptation": new}
    return result(row, seed, *(score(mean, name, **where) for name, mean in settings.items()))


def test_nothing_is_closed_by_carrying_over_and_all_by_the_best():
    assert gap_closed(-30.0, -30.0, -5.0) == 0
    assert gap_closed(-5.0, -30.0, -5.0) == 1
    assert gap_closed(-55.0, -30.0, -5.0) == -1
    with pytest.raises(
        ValueError, match=r"the best return -30\.0 is not above the one carried over"
    ):
        gap_closed(-5.0, -30.0, -30.0)


def test_the_best_known_is_whoever_does_best_with_the_true_reward():
    expert = adapted("pemirl", 0, -30.0, -6.0)
    assert best_known([expert], "right") == ("expert", -5.0)
    rl = [result("rl", seed, score(-5.0 + seed, "rl_with_true_reward")) for seed in (0, 4)]
    assert best_known([expert, *rl], "right") == ("rl", -3.0)  # the mean over seeds
    scripted = result("scripted", 0, score(-2.0, "expert"))
    assert best_known([expert, *rl, scripted], "right") == ("scripted", -2.0)
    with pytest.raises(ValueError, match="no expert was measured under 'left'"):
        best_known([expert], "left")


def test_a_seeds_gap_is_its_own_and_starts_where_it_carried_over():
    results = [adapted("pemirl", 0, -30.0, -10.0), adapted("pemirl", 1, -25.0, -25.0)]
    results.append(result("meta_il", 0, score(-30.0, "policy_generalisation")))
    rows = {"pemirl": "PEMIRL", "meta_il": "Meta-IL", "gone": "Gone"}
    lines = gap_table(results, rows, variant="right").splitlines()
    assert lines[0].endswith(
        "| share of the gap closed, right (best known: expert, -5.00) | every seed |"
    )
    # 20 of 25, and none of 20: 0.4, and 12.71 x 0.5657 / sqrt(2) to either side.
    assert lines[2:] == ["| PEMIRL | 2 | 0.40 [-4.68, 5.48] | 0.80, 0.00 |"]
    assert gap_table(results, {"meta_il": "Meta-IL"}, variant="right") == ""
