"""A folder is one run's, and one process's at a time; what is damaged in it is named."""

import json
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml

from pemirl_lab.runs import run_folder
from pemirl_lab.runs.run_folder import RunFolder, read_curve, read_run, read_seconds

KILLED = """
import os, signal, sys
from pemirl_lab import cli
from pemirl_trl.methods import PEMIRL

iteration, begun = PEMIRL.iteration, []

def killed(self):
    begun.append(1)
    if len(begun) == 6:
        os.kill(os.getpid(), signal.SIGKILL)
    return iteration(self)

PEMIRL.iteration = killed
cli.run("meta_train", sys.argv[1:])
"""
HOLDING = """
import sys
from pemirl_lab.runs.run_folder import RunFolder
folder = RunFolder("run", {}, logger=None, checkpoint_every=1)
print("held", flush=True)
sys.stdin.read()
"""
TRAINING = (
    "preset=smoke", "threads=1", "method=pemirl", "run_dir=run",
    "training.iterations=6", "checkpoint_every=2",
)  # fmt: skip


def claim(record=None, **changed):
    given = {"logger": None, "checkpoint_every": 1} | changed
    return RunFolder("run", {"seed": 0} if record is None else record, **given)


def test_a_second_process_is_refused_while_the_first_is_at_work(here):
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", HOLDING], stdin=pipe, stdout=pipe) as holder:
        assert holder.stdout.readline() == b"held\n"
        with pytest.raises(ValueError, match="another process is at work in run: wait for it, or"):
            claim()
        holder.stdin.close()  # it reads to its end, and leaves
    claim({}).release()


def test_a_process_may_come_back_to_its_folder_and_let_others_have_it(here):
    first, second = claim(), claim()
    first.release()
    assert second._lock.is_locked  # it is held until the last of them has let go
    second.release()
    assert not second._lock.is_locked


def test_a_folder_of_another_configuration_is_refused(settings, smoke, here):
    shutil.copytree(smoke[0] / "smoke", "smoke")
    given = ("preset=smoke", "threads=1", "run_dir=smoke")
    before = {f: f.read_bytes() for f in (here / "smoke").glob("*.*")}
    other, _ = settings("quickstart", *given, "seed=7", "training.iterations=3")
    message = "smoke holds a run with another seed, training: give another run_dir, or delete that"
    with pytest.raises(ValueError, match=message):
        RunFolder.of(other)
    assert {f: f.read_bytes() for f in (here / "smoke").glob("*.*")} == before


def test_what_results_do_not_depend_on_may_change(settings, smoke, here):
    shutil.copytree(smoke[0] / "smoke", "smoke")
    free = ("threads=2", "logger=null", "checkpoint_every=7")
    given, _ = settings("quickstart", "preset=smoke", "run_dir=smoke", *free)
    folder = RunFolder.of(given)
    folder.release()
    stored = yaml.safe_load((here / "smoke/config.yaml").read_text(encoding="utf-8"))
    assert (stored["threads"], stored["logger"], stored["checkpoint_every"]) == (2, None, 7)
    assert folder.checkpoint_every == 7


def test_results_depend_on_the_learners_threads_and_so_do_runs(settings, smoke, here):
    shutil.copytree(smoke[0] / "smoke", "smoke")
    other, _ = settings("quickstart", "preset=smoke", "run_dir=smoke", "torch_threads=2")
    with pytest.raises(ValueError, match="smoke holds a run with another torch_threads: give"):
        RunFolder.of(other)


def test_a_folder_in_which_nothing_began_takes_the_right_values(here):
    """A wrong name of a file is refused after the folder was claimed: the right one is not."""
    claim({"demonstrations": "typo"}).release()
    folder = claim({"demonstrations": "right"})
    (here / "right").touch()
    folder.reads("demonstrations", here / "right")
    folder.release()
    with pytest.raises(ValueError, match="run holds a run with another demonstrations: give"):
        claim({"demonstrations": "other"})


def test_of_the_librarys_settings_those_that_changed_are_named(here):
    claim({"seed": 0, "settings": {"training": {"iterations": 2}, "rollouts": 5}}).release()
    (here / "run/seconds.json").write_text("{}")
    message = "run holds a run with another rollouts, training.iterations: give"
    with pytest.raises(ValueError, match=message):
        claim({"seed": 0, "settings": {"training": {"iterations": 3}}})


def test_an_input_that_changed_is_refused_by_its_name(here):
    file = here / "model.safetensors"
    file.write_bytes(b"1")
    folder = claim()
    assert folder.reads("model", file) == file
    file.write_bytes(b"2")
    message = f"{file} is not the model that the run in run began with (its content has changed "
    with pytest.raises(ValueError, match=re.escape(message)):
        folder.reads("model", file)
    other = here / "copy.safetensors"
    other.write_bytes(b"1")
    assert folder.reads("model", other) == other  # the content counts, wherever it lies
    assert folder.reads("demonstrations", file) == file
    stored = json.loads(folder.file("inputs.json").read_text(encoding="utf-8"))
    assert list(stored) == ["model", "demonstrations"]
    assert stored["model"]["file"] == str(file)
    folder.release()


def test_seconds_are_recorded_before_the_end_and_added_up(here, monkeypatch):
    """A process that is killed runs no ``finally``: what it recorded so far has to stand there."""
    clock = iter([10.0, 13.0, 13.5, 100.0, 101.0])
    monkeypatch.setattr(run_folder, "time", SimpleNamespace(perf_counter=lambda: next(clock)))
    killed = claim()
    with killed.timed("stage") as record:
        record()
        assert json.loads(killed.file("seconds.json").read_text()) == {"stage": 3.0}
    with claim().timed("stage"):
        pass
    assert json.loads(killed.file("seconds.json").read_text()) == {"stage": 4.5}


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("curves/stage.json", "{", "run/curves/stage.json is damaged: it is no JSON"),
        ("curves/stage.json", "[[1]]", r"run/curves/stage.json is damaged: expected a list of \[s"),
        ("curves/stage.json", '[[1, "a"]]', "run/curves/stage.json is damaged: expected a list"),
        ("seconds.json", "\xff", "run/seconds.json is damaged: it is no JSON"),
        ("seconds.json", "[]", "run/seconds.json holds a list; expected a JSON object"),
        ("seconds.json", '{"stage": -1}', "run/seconds.json is damaged: expected seconds by stage"),
        ("seconds.json", '{"stage": "1"}', "run/seconds.json is damaged: expected seconds by s"),
        ("config.yaml", "seed: [", "run/config.yaml is damaged: it is no YAML"),
        ("config.yaml", "seed", "run/config.yaml is damaged: expected the configuration of a run"),
        ("inputs.json", "{", "run/inputs.json is damaged: it is no JSON"),
    ],
)
def test_a_damaged_file_is_named(here, name, content, message):
    claim().release()
    file = here / "run" / name
    file.parent.mkdir(exist_ok=True)
    file.write_bytes(content.encode("latin-1"))
    with pytest.raises(ValueError, match=message):
        read_damaged(name)
    assert file.read_bytes() == content.encode("latin-1")


def read_damaged(name):
    match name.split("/")[0]:
        case "curves":
            read_curve(Path("run"), "stage")
        case "seconds.json":
            read_seconds(Path("run"))
        case "config.yaml":
            claim()
        case "inputs.json":
            claim().reads("model", Path("run/config.yaml"))


def test_what_a_run_was_is_told_without_where_it_stood(here):
    claim({"seed": 3, "run_dir": "run", "model_file": "there"}).release()
    told = read_run(here / "run")
    assert told["seed"] == 3
    assert {"versions", "hardware", "commit"} <= set(told)
    assert not {"run_dir", "model_file"} & set(told)
    assert read_curve(here / "run", "none") == []
    assert read_seconds(here / "run") == {}


def test_a_killed_run_goes_on_as_if_it_had_not_been(command, here, process):
    """Killed in iteration 6 with a checkpoint of 4: iteration 5 is trained and logged anew.

    Also with other values of what results do not depend on.
    """
    killed = process(*TRAINING, cwd=here, code=KILLED)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    assert steps(here / "run") == {(1, 2, 3, 4, 5)}
    assert not (here / "run/model.safetensors").exists()
    assert list(read_seconds(here / "run")) == ["meta-il", "pemirl"]  # up to the checkpoint
    command("meta_train", [*TRAINING, "threads=2", "checkpoint_every=3"])
    command("meta_train", [*TRAINING, "run_dir=whole"])
    for name in ("model.safetensors", "meta_il.safetensors", "curves/pemirl.json"):
        assert (here / "run" / name).read_bytes() == (here / "whole" / name).read_bytes(), name
    assert steps(here / "run") == steps(here / "whole") == {(1, 2, 3, 4, 5, 6)}
    whole = {f.relative_to(here / "whole"): f.read_text() for f in metrics(here / "whole")}
    assert {f.relative_to(here / "run"): f.read_text() for f in metrics(here / "run")} == whole


def metrics(run):
    return sorted((run / "metrics/scalars/pemirl").rglob("*.csv"))


def steps(run):
    """Of the lines of each file of the metrics."""
    rows = [file.read_text(encoding="utf-8").splitlines() for file in metrics(run)]
    assert len(rows) > 5
    return {tuple(int(row.split(",")[0]) for row in of_file) for of_file in rows}
