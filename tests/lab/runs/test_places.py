"""Where files are looked for, and where not."""

import re
import tomllib

import pytest

from pemirl_lab.measuring.experts import load_expert
from pemirl_lab.runs import places
from pemirl_trl import DemonstrationDataset


@pytest.fixture
def repository(here, monkeypatch):
    """A wheel's package and a checkout, both empty, and another working directory."""
    monkeypatch.setattr(places, "PACKAGE", here / "package")
    monkeypatch.setattr(places, "CHECKOUT", here / "checkout")
    for name in ("package/data", "checkout/data", "user/data"):
        (here / name).mkdir(parents=True)
    monkeypatch.chdir(here / "user")
    return here


def test_data_is_the_users_then_the_packages_then_the_checkouts(repository):
    name = "data/maze.safetensors"
    for folder in ("checkout", "package"):
        (repository / folder / name).touch()
        assert places.data_file(name) == repository / folder / name
    (repository / "user" / name).touch()
    assert places.data_file(name).absolute() == repository / "user" / name


def test_a_file_that_is_nowhere_names_the_places(repository):
    searched = [f"{repository}/{folder}/data/no.st" for folder in ("package", "checkout")]
    expected = f"no file data/no.st (looked at data/no.st, {', '.join(searched)})"
    with pytest.raises(FileNotFoundError, match=re.escape(expected)):
        places.data_file("data/no.st")
    with pytest.raises(FileNotFoundError, match=r"no file /no\.st \(looked at /no\.st\)"):
        places.data_file("/no.st")


def test_a_folder_may_hold_demonstrations_or_be_none_of_these(repository):
    """LeRobot's data sets are folders; whoever reads one says what is wrong with it."""
    folder = places.data_file("data")
    with pytest.raises(ValueError, match="is a folder with"):
        DemonstrationDataset.load(folder)
    with pytest.raises(ValueError, match="is a directory; expected a regular file"):
        load_expert("data")


def test_home_is_expanded(repository, monkeypatch):
    monkeypatch.setenv("HOME", str(repository))
    (repository / "mine.safetensors").touch()
    assert places.data_file("~/mine.safetensors") == repository / "mine.safetensors"
    assert places.run_file("~/mine.safetensors", "meta_train") == repository / "mine.safetensors"


def test_runs_are_looked_for_from_here_alone(repository):
    """Another checkout's model would be taken silently, if the repository's folder counted too."""
    (repository / "checkout/data/model.safetensors").touch()
    assert places.data_file("data/model.safetensors").is_file()
    expected = f"no file {repository}/user/data/model.safetensors: pemirl meta_train writes it"
    with pytest.raises(FileNotFoundError, match=re.escape(expected)):
        places.run_file("data/model.safetensors", "meta_train")


def test_what_the_wheel_brings_is_what_the_quickstart_needs(settings):
    """The wheel's list stands in pyproject.toml; both ends of it exist."""
    project = tomllib.loads((places.CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))
    brought = project["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    given, _ = settings("quickstart")
    needed = {given.demonstrations, given.test_demonstrations}
    needed |= {given.expert_file(e) for e in (given.environment, given.test_environment)}
    zoo = {"pemirl_trl/zoo/point_maze.safetensors"}  # what load_model takes a name of
    assert {f"pemirl_lab/{name}" for name in needed} | zoo == set(brought.values())
    for source, target in brought.items():
        assert (places.CHECKOUT / source).is_file()
        assert target.split("/", 1)[1] == source
