"""Development sessions: ``nox`` alone runs the tests, the linters and the type checker."""

import os
import tempfile
from ctypes.util import find_library
from pathlib import Path

import nox

nox.options.sessions = ["tests", "lint", "types"]
nox.options.default_venv_backend = "virtualenv"
nox.options.reuse_venv = "yes"

CONSTRAINTS = Path(__file__).with_name("constraints.txt")
HEADLESS = {"MUJOCO_GL": "osmesa" if find_library("OSMesa") else "disable"} | {
    name: value for name, value in os.environ.items() if name == "MUJOCO_GL"
}
# glibc hands large freed blocks back to the kernel, which then clears them anew for each batch.
KEEP_MEMORY = {"MALLOC_TRIM_THRESHOLD_": "2000000000", "MALLOC_MMAP_THRESHOLD_": "2000000000"}
ZOO = ("point_maze", "sweeper", "sawyer_pusher", "ant")
PROVED = {  # models of tasks that are not the project's own: what proves them, and keeps one
    "pendulum": "own_pendulum/run.py",
    "grid": "own_grid/run_grid.py",
    "puck": "own_puck/run_puck.py",
    "unicycle": "own_unicycle/run_unicycle.py",
    "reacher": "own_gymnasium/prove.py reacher",
    "half_cheetah": "own_gymnasium/prove.py half_cheetah",
}
STEPPED = ("point_maze/left", "ant/normal", "sweeper/normal", "sawyer_pusher/normal")
GROWN = ("point_maze/left", "sweeper/normal")  # how their trainings grow
DETERMINISTIC = HEADLESS | {"CUDA_VISIBLE_DEVICES": ""}

SMOKE = """
import pathlib
import pemirl_envs, pemirl_lab, pemirl_trl
for package in (pemirl_envs, pemirl_lab, pemirl_trl):
    assert "site-packages" in pathlib.Path(package.__file__).parts, package.__file__
batch = pemirl_envs.make("point_maze/left", num_envs=4).rollout(3)
assert batch.shape == (4, 3), batch.shape
environment = pemirl_envs.load("point_maze", "left")
assert environment.reset().first()
model = pemirl_trl.load_model("point_maze")
assert (model.observation_dim, model.action_dim, model.horizon) == (2, 2, 100)
assert pemirl_trl.load_card("point_maze").licence == "MIT"
reward = pemirl_trl.load_reward("point_maze")
assert reward([[0.3, 0.5]] * 4, [0.0, 0.0, 0.0]).shape == (4, 1)
print("pemirl-trl", pemirl_trl.__version__, "works outside its checkout")
"""


def install(session: nox.Session, *requirements: str) -> None:
    """Install the tested versions."""
    session.install("-c", str(CONSTRAINTS), *requirements)


@nox.session
def tests(session: nox.Session) -> None:
    """Run the fast tests."""
    install(session, "-e", ".[test]")
    session.run("pytest", *session.posargs, env=DETERMINISTIC)


@nox.session
def newest(session: nox.Session) -> None:
    """Run the fast tests with the newest versions that the ranges allow; arguments install others.

    ``nox -s newest -- "mujoco>=4"`` tries what lies beyond a range.
    """
    session.install("--upgrade", "--upgrade-strategy", "eager", "-e", ".[test]")
    if session.posargs:
        session.run("pip", "install", "--upgrade", *session.posargs)
    session.run("pip", "list")
    session.run("pytest", env=DETERMINISTIC)


@nox.session
def long(session: nox.Session) -> None:
    """Run the tests that take minutes, and keep their verdicts in results/long_tests.txt."""
    install(session, "-e", ".[test]")
    shown = ("-q", "--no-header", "-rP", "--show-capture=stdout")  # verdicts, no progress bars
    durations = ("--durations=0", "--durations-min=1")
    Path("results").mkdir(exist_ok=True)
    with open("results/long_tests.txt", "w", encoding="utf-8") as verdicts:
        session.run(
            *("pytest", "-m", "long", *shown, *durations, *session.posargs),
            env=DETERMINISTIC,
            stdout=verdicts,
        )


@nox.session
def robustness(session: nox.Session) -> None:
    """Damage files, values and runs at random, and keep the counts in results/robustness.txt."""
    install(session, "-e", ".[test]")
    Path("results").mkdir(exist_ok=True)
    with open("results/robustness.txt", "w", encoding="utf-8") as counts:
        options = ("-q", "--no-header", "-rP", "--show-capture=stdout", "-m", "long or not long")
        session.run(
            "pytest", *options, "tests/fuzz", *session.posargs, env=DETERMINISTIC, stdout=counts
        )


@nox.session
def lint(session: nox.Session) -> None:
    """Check style, formatting and the direction of imports."""
    install(session, "ruff", "import-linter")
    session.run("ruff", "check")
    session.run("ruff", "format", "--check")
    session.run("lint-imports", env={"PYTHONPATH": os.pathsep.join(["src", "envs"])})


@nox.session
def types(session: nox.Session) -> None:
    """Check types."""
    install(session, "-e", ".[minari,video]", "mypy", "types-PyYAML")
    session.run("mypy", *session.posargs)


@nox.session
def docs(session: nox.Session) -> None:
    """Build the site into docs/_build/html, and run the examples on pages and in docstrings.

    A warning is an error: a dead link inside, an equation or a docstring that cannot be read, a
    public name without an entry, a notebook that raises. ``-- linkcheck`` asks the network for the
    links to elsewhere, too; continuous integration does not, so that it passes without one.
    """
    install(session, "-e", ".[docs,test]")  # the pages' examples use what the tests do
    strict = ("-W", "--keep-going", "-c", "docs", ".")
    if "linkcheck" in session.posargs:
        session.run("sphinx-build", "-b", "linkcheck", *strict, "docs/_build/links", env=HEADLESS)
        return
    session.run("sphinx-build", "-b", "html", *strict, "docs/_build/html", env=DETERMINISTIC)
    session.run(
        "pytest", "src", "envs", "tests/test_docs.py", "tests/test_readme.py", env=DETERMINISTIC
    )


@nox.session
def quickstart(session: nox.Session) -> None:
    """Run the quickstart as a user does; arguments are overrides, as of `pemirl quickstart`."""
    install(session, "-e", ".")
    session.run("pemirl", "quickstart", *session.posargs, env=HEADLESS | KEEP_MEMORY)


@nox.session
def zoo(session: nox.Session) -> None:
    """Train the models of zoo/ anew, with their cards; arguments are names (all: two hours)."""
    install(session, "-e", ".")
    env = HEADLESS | KEEP_MEMORY
    for name in session.posargs or (*ZOO, *PROVED):
        file = f"zoo/{name}.safetensors"
        if name in PROVED:
            script, *words = PROVED[name].split()
            session.run("python", f"examples/{script}", *words, "0", f"--zoo={file}", env=env)
            continue
        run = f"runs/zoo/{name}"
        session.run("pemirl", "quickstart", f"experiment={name}", f"run_dir={run}", env=env)
        card = ("licence=MIT", f"command=nox -s zoo -- {name}")
        model = f"model_file={run}/model.safetensors"
        session.run("pemirl", "export_model", model, f"to={file}", *card, env=env)


@nox.session
def bench(session: nox.Session) -> None:
    """Measure throughput on all domains; arguments (``--num-threads 2``) go to most."""
    install(session, ".[test]")
    results = Path("results/benchmarks")
    results.mkdir(parents=True, exist_ok=True)
    env = HEADLESS | KEEP_MEMORY | {"OMP_WAIT_POLICY": "passive"}  # as the commands have it
    for task in STEPPED:
        output = ("--output", str(results / f"stepping_{task.split('/')[0]}.json"))
        options = ("--task", task, *output, *session.posargs)
        session.run("python", "benchmarks/stepping.py", *options, env=env)
    output = ("--output", str(results / "integrators.json"))
    session.run("python", "benchmarks/integrators.py", *output, env=env)
    for task in STEPPED:
        output = ("--output", str(results / f"training_{task.split('/')[0]}.json"))
        options = ("--task", task, *output, *session.posargs)
        session.run("python", "benchmarks/training.py", *options, env=env)
    for task in GROWN:
        output = ("--output", str(results / f"growth_{task.split('/')[0]}.json"))
        session.run("python", "benchmarks/growth.py", "--task", task, *output, env=env)


@nox.session(reuse_venv=False)
def build(session: nox.Session) -> None:
    """Build the wheel from the source distribution and use it outside the checkout."""
    install(session, "build")
    with tempfile.TemporaryDirectory() as outside:
        session.run("python", "-m", "build", "--outdir", outside)
        install(session, *map(str, Path(outside).glob("*.whl")))
        session.chdir(outside)
        session.run("python", "-c", SMOKE, env=DETERMINISTIC)
        one = ("demonstration=data/point_maze_test.safetensors", "index=0")
        session.run("pemirl", "infer", "model_file=point_maze", *one, env=DETERMINISTIC)
        session.run("pemirl", "quickstart", "preset=smoke", env=DETERMINISTIC)
