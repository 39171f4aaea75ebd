"""Stages run by their names, and resume from checkpoints of their own."""

import pytest

from pemirl_trl.methods.meta_il import MetaIL, MetaILConfig
from pemirl_trl.methods.stages import stages


def imitation(reach):
    config = MetaILConfig(steps=4, steps_per_iteration=2, batch_size=4)
    return MetaIL(reach.model(), reach.demonstrations, config)


def test_iterations_are_reported_by_stage(reach):
    seen = []
    run = stages(lambda stage, iteration, metrics: seen.append((stage, iteration)), None, "a")
    run("first", imitation(reach))
    run("second", imitation(reach))
    assert seen == [("first", 1), ("first", 2), ("second", 1), ("second", 2)]


def test_a_stage_that_is_done_is_not_done_again(reach, tmp_path, state, differences):
    first, second, seen = imitation(reach), imitation(reach), []
    stages(None, tmp_path, "a")("imitation", first)
    stages(lambda *report: seen.append(report), tmp_path, "a")("imitation", second)
    assert seen == []
    assert differences(state(first), state(second)) == []


def test_checkpoints_of_another_training_are_refused(reach, tmp_path):
    stages(None, tmp_path, "a")("imitation", imitation(reach))
    with pytest.raises(ValueError, match="is of the run 'imitation of a'; expected 'imitation of"):
        stages(None, tmp_path, "b")("imitation", imitation(reach))
