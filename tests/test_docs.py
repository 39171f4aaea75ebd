"""What people read: links lead somewhere, commands compose, snippets run."""

import importlib
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from hydra.errors import HydraException

import pemirl_envs
from pemirl_lab.cli import COMMANDS, OTHERS
from pemirl_lab.runner import OWN_TASK
from pemirl_lab.runs.composition import compose, plain
from pemirl_lab.runs.own_task import is_own, parse_words
from pemirl_lab.runs.settings import parse
from pemirl_lab.runs.tables import read_table, table_names
from pemirl_trl import DemonstrationDataset
from pemirl_trl.methods import METHODS

ROOT = Path(__file__).parents[1]
FOLDERS = ("", "docs", "data", "recipes")
DOCUMENTS = sorted(page for folder in FOLDERS for page in (ROOT / folder).glob("*.md"))
NAMES = [str(page.relative_to(ROOT)) for page in DOCUMENTS]
COMMAND = re.compile(r"^pemirl (.+)$|`pemirl ([^`]+)`", re.MULTILINE)


def without_code(text):
    return re.sub(r"```.*?```", "", text, flags=re.DOTALL)


def anchors(page):
    """The anchors that GitHub gives to a page's headings."""
    headings = re.findall(r"^#+ (.+)$", without_code(page.read_text("utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def dead_links(page):
    dead = []
    for target in re.findall(r"\]\(((?!http)[^)\s]+)\)", without_code(page.read_text("utf-8"))):
        name, _, anchor = target.partition("#")
        linked = page.parent / name if name else page
        if not linked.exists() or (anchor and anchor not in anchors(linked)):
            dead.append(target)
    return dead


@pytest.mark.parametrize("page", DOCUMENTS, ids=NAMES)
def test_pictures_links_and_anchors_exist(page):
    assert dead_links(page) == []


def test_a_dead_link_is_seen(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# Some words\n[a](#some-words) [b](#others) [c](no.md) [d](https://x.org)")
    assert dead_links(page) == ["#others", "no.md"]


def test_every_page_is_linked_from_another_one():
    linked = {
        (page.parent / target.split("#")[0]).resolve()
        for page in DOCUMENTS
        for target in re.findall(r"\]\((?!http|#)([^)\s]+)\)", page.read_text("utf-8"))
    }
    lonely = {page.name for page in (ROOT / "docs").glob("*.md")} - {p.name for p in linked}
    assert lonely == set()


# --- commands ----------------------------------------------------------------------------------


def commands():
    found = {}
    for page in DOCUMENTS:
        for block, inline in COMMAND.findall(page.read_text("utf-8")):
            words = tuple(shlex.split(block or inline, comments=True))
            if words[0].isidentifier() and words[0].islower() and "..." not in words:
                found.setdefault(words, page.name)
    return found


def check(words):
    """Raise unless ``pemirl WORDS`` is a command whose values are all legal."""
    command, *given = words
    assert command in COMMANDS, f"no command {command}"
    if is_own(given):  # on an environment of the user's own
        assert command in OWN_TASK
        if given[1:] == ["--help"]:
            return  # env= alone: no value is missing that the help would not name
        module = importlib.import_module(f"pemirl_lab.commands.{command}")
        parse_words(given, module.OwnEnvironment, rest=True)
        return
    values = [w for w in given if not w.startswith("-") and "hydra" not in w]
    chosen = [w if "=[" in w else w.split(",")[0] for w in values]  # of a sweep, the first
    own = importlib.import_module(f"pemirl_lab.commands.{command}").Own
    if command == "reproduce":
        values = dict(word.split("=", 1) for word in chosen)
        table = read_table(values.pop("table", "point_maze"))
        rows = [values.pop("row")] if "row" in values else table.rows
        rest = [f"{name}={value}" for name, value in values.items()]
        for row in rows:
            parse(table.compose(row, rest), own)
    else:
        parse(plain(compose(command, chosen)), own)


@pytest.mark.parametrize("words", commands(), ids=" ".join)
def test_a_command_on_a_page_can_be_run(words):
    if words[0] not in OTHERS:
        check(words)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("train", "task=ant"), "no command train"),
        (("evaluate", "env=my_module:make_env", "--help"), "OWN_TASK|assert"),
        (("meta_train", "env=my_module:make_env", "run_dir=R"), "missing demonstrations"),
        (("meta_train", "training.nothing=1"), "nothing"),
        (("quickstart", "method=airl"), "experiment=point_maze is task=point_maze"),
        (("reproduce", "row=nothing"), "has no row 'nothing'"),
    ],
)
def test_a_wrong_command_is_seen(words, message):
    with pytest.raises((AssertionError, ValueError, HydraException), match=message):
        check(words)


def test_the_page_of_commands_lists_them_all():
    listed = re.findall(r"^\| `(\w+)` \|", (ROOT / "recipes/README.md").read_text("utf-8"), re.M)
    assert sorted(listed) == sorted([*COMMANDS, *OTHERS])


def test_the_pages_list_all_methods_tables_and_domains():
    method = (ROOT / "docs/method.md").read_text("utf-8")
    assert re.findall(r"^\| `(\w+)` \|", method, re.M) == sorted(METHODS, key=method.index)
    tables = (ROOT / "docs/reproducibility.md").read_text("utf-8")
    assert [name for name in table_names() if f"`{name}`" not in tables] == []
    domains = {name.split("/")[0] for name in pemirl_envs.TASKS}
    listed = (ROOT / "docs/environments.md").read_text("utf-8")
    assert [name for name in domains if f"`{name}`" not in listed] == []


# --- snippets ----------------------------------------------------------------------------------


def snippets_of(page):
    return re.findall(r"```python\n(.*?)```", (ROOT / page).read_text("utf-8"), re.DOTALL)


# These need files: tests/test_readme.py and tests/test_tutorial.py run them.
OTHERWISE_RUN = ("README.md", "docs/tutorial.md")


@pytest.mark.parametrize("page", [n for n in NAMES if snippets_of(n) and n not in OTHERWISE_RUN])
def test_snippets_run(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for snippet in snippets_of(page):
        exec(compile(snippet, page, "exec"), names)


REGISTERED = """
import pemirl_envs
from toy_task import Cart
pemirl_envs.register_domain("cart", {{"normal": Cart, "heavy": Cart}})
{script}
"""
CART = {
    r"^task: .*": "task: cart",
    r"point_maze/left": "cart/normal",
    r"point_maze/right": "cart/heavy",
    r"data/point_maze_": "",
}


def test_the_script_for_a_task_from_outside_trains_on_it(tmp_path):
    """What docs/own_task.md says: a registered domain, a YAML file and three lines."""
    text = (ROOT / "docs/own_task.md").read_text("utf-8")
    script = re.search(r"```text\n(import sys\n.*?)```", text, re.DOTALL)[1]
    (tmp_path / "lab.py").write_text(REGISTERED.format(script=script))
    (tmp_path / "toy_task.py").write_text((ROOT / "tests/envs/toy_task.py").read_text("utf-8"))
    (tmp_path / "toy_task.xml").write_text((ROOT / "tests/envs/toy_task.xml").read_text("utf-8"))
    settings = (ROOT / "src/pemirl_lab/conf/task/point_maze.yaml").read_text("utf-8")
    for old, new in CART.items():
        settings = re.sub(old, new, settings, flags=re.MULTILINE)
    (tmp_path / "conf/task").mkdir(parents=True)
    (tmp_path / "conf/task/cart.yaml").write_text(settings)
    episodes = [(torch.randn(11, 2), torch.randn(10, 1)) for _ in range(12)]
    DemonstrationDataset.from_episodes(episodes).save(tmp_path / "train.safetensors")
    words = ["meta_train", "task=cart", "method=pemirl_robust", "preset=smoke", "threads=1"]
    done = subprocess.run(
        [sys.executable, "lab.py", *words], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "runs/smoke/meta_train/cart/pemirl_robust/seed0/model.safetensors").exists()
