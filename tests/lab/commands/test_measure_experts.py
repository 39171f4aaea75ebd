"""What experts reach, also where the dynamics have changed, and controllers by hand."""

from dataclasses import replace

import pytest

from pemirl_lab.commands import measure_experts
from pemirl_lab.results import normalised_return, read

from ..conftest import ROOT


def test_experts_and_the_one_that_is_carried_over(settings, here):
    measure_experts.run(*settings("measure_experts", "task=point_maze", "evaluation.episodes=1"))
    own, carried = (
        read(here / "results/point_maze" / row / "seed0.json")
        for row in ("expert", "expert_carried_over")
    )
    assert {(s.setting, s.variant) for s in own.scores} == {("expert", "left"), ("expert", "right")}
    assert [s.normalised for s in own.scores] == pytest.approx([1.0, 1.0])
    (lost,) = carried.scores
    assert (lost.setting, lost.variant) == ("policy_generalisation", "right")
    assert lost.normalised < 0.6  # it stands before the barrier
    assert own.reward["final_distance_m/right"] < 0.02 < carried.reward["final_distance_m/right"]


def test_controllers_by_hand_are_measured_beside_the_experts(settings, here):
    given = settings("measure_experts", "task=sawyer_pusher", "evaluation.episodes=1")
    results = measure_experts.run(*given)
    found = {r.row: {(s.setting, s.variant): s.normalised for s in r.scores} for r in results}
    assert found["scripted"].keys() == found["expert"].keys()
    assert min(found["scripted"].values()) > 0.95
    (lost,) = found["scripted_carried_over"].values()
    assert lost < 0.9 < min(found["scripted"].values())


def test_a_new_expert_takes_the_place_of_the_old_one_in_stored_results(settings, here):
    """Normalised returns change under its dynamics, and nothing else does."""
    stored = here / "results/point_maze/pemirl/seed0.json"
    stored.parent.mkdir(parents=True)
    stored.write_bytes((ROOT / "results/point_maze/pemirl/seed0.json").read_bytes())
    before = read(stored)
    other = ROOT / "data/point_maze_left_expert.safetensors"  # worse, where the barrier is right
    given = (
        "task=point_maze",
        "evaluation.episodes=1",
        f"experts.right={other}",
        "rescale=[right]",
    )
    measure_experts.run(*settings("measure_experts", *given))
    after = read(stored)
    measured = read(here / "results/point_maze/expert/seed0.json").score("expert", "right")
    for old, new in zip(before.scores, after.scores, strict=True):
        assert new.per_task == old.per_task
        assert new.random == old.random
        if new.variant == "left":
            assert new == old
            continue
        assert new.expert < old.expert - 10
        assert new.normalised == normalised_return(new.mean, new.random, new.expert)
        if new.goals == "all":
            assert new.expert == pytest.approx(measured.mean)
    assert replace(after, scores=before.scores) == before
    twice = stored.read_bytes()
    measure_experts.run(*settings("measure_experts", *given))
    assert stored.read_bytes() == twice
