"""Lines are said once, also when a training is killed and goes on."""

import json
import logging

import pytest
import torch

from pemirl_trl.checkpoint import TrainingCheckpoint
from pemirl_trl.health import SIGNS
from pemirl_trl.methods import train
from pemirl_trl.methods.health_log import HealthLog, read_health
from pemirl_trl.methods.stages import stages

(EXPLODING,) = (sign for sign in SIGNS if sign.name == "r exploding")
ITERATIONS = 30


class Sickens:
    """|r| is large from iteration 6 to 20."""

    iterations, env_steps = ITERATIONS, 0

    def __init__(self):
        self.done = 0

    def iteration(self):
        self.done += 1
        return {"reward/magnitude": 100.0 if 6 <= self.done <= 20 else 1.0}

    def components(self):
        return {"method": self}

    def state_dict(self):
        return {"done": self.done}

    def load_state_dict(self, state):
        self.done = state["done"]


class KilledError(Exception):
    pass


def lines(caplog):
    return [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]


BEGIN, END = (
    f"stage, iteration {first + EXPLODING.patience - 1}: {text}"
    for first, text in ((6, "r exploding since"), (21, "no longer: r exploding"))
)


def attempt(folder, kill_at, every):
    """Train until a kill, as a process of its own would: nothing but the files is common."""
    log, checkpoint = HealthLog("stage", folder / "health.json"), TrainingCheckpoint(folder / "c")

    def report(iteration, metrics):
        log(iteration, metrics)
        if iteration % every == 0:
            log.save()
        if iteration == kill_at:
            raise KilledError

    train(Sickens(), checkpoint=checkpoint, checkpoint_every=every, on_iteration=report)
    log.save()


@pytest.mark.parametrize("kill_at", range(1, ITERATIONS, 4))
def test_a_killed_training_says_the_lines_of_a_whole_one(tmp_path, caplog, kill_at):
    with pytest.raises(KilledError):
        attempt(tmp_path, kill_at, every=7)
    attempt(tmp_path, None, every=7)
    said = lines(caplog)
    assert [line[: len(BEGIN)] for line in said[:1]] == [BEGIN]
    assert [line[: len(END)] for line in said[1:]] == [END]
    rows, kept = read_health(tmp_path / "health.json")
    assert [iteration for iteration, _ in rows] == [*range(1, ITERATIONS + 1)]
    assert len(kept) == 2


def test_a_line_of_before_the_kill_is_not_said_again_by_the_one_who_goes_on(tmp_path, caplog):
    with pytest.raises(KilledError):
        attempt(tmp_path, 12, every=25)  # no checkpoint yet: all of it is done anew
    assert len(lines(caplog)) == 1
    caplog.clear()
    attempt(tmp_path, None, every=25)
    assert [line[: len(END)] for line in lines(caplog)] == [END]


def test_stages_warn_and_sum_up(tmp_path, caplog):
    caplog.set_level(logging.INFO, "pemirl_trl")
    stages(None, tmp_path, "a training")("stage", Sickens())
    assert lines(caplog)[0].startswith(BEGIN)
    assert "stage: | sign |" in caplog.text
    assert (tmp_path / "stage/health.json").exists()
    stages(None, None, "")("another", Sickens())  # without a folder
    assert len(lines(caplog)) == 4


@pytest.mark.parametrize(
    "content", ["", "[]", '{"rows": [[1]], "said": []}', '{"rows": [[1, {"a": "b"}]], "said": []}']
)
def test_a_damaged_file_is_named(tmp_path, content):
    file = tmp_path / "health.json"
    file.write_text(content)
    with pytest.raises(ValueError, match=r"health\.json is damaged"):
        HealthLog("stage", file)


def test_the_file_is_plain_numbers(tmp_path):
    log = HealthLog("stage", tmp_path / "health.json")
    log(1, {"reward/magnitude": float(torch.tensor(2.0))})
    log.save()
    assert json.loads((tmp_path / "health.json").read_text()) == {
        "rows": [[1, {"reward/magnitude": 2.0}]],
        "said": [],
    }
