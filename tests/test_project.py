"""Laws of the project as a whole."""

import ast
import inspect
import re
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

import pemirl_envs
import pemirl_trl

ROOT = Path(__file__).parents[1]
LIBRARY = ("src", "envs")
ALL_CODE = (*LIBRARY, "recipes", "benchmarks", "examples")
FIRST_PARTY = {"pemirl_trl", "pemirl_envs", "pemirl_lab", "recipes"}
MAX_FILE_LINES = 400
MAX_FUNCTION_LINES = 70

Check = Callable[[ast.Module], Iterator[ast.AST]]


def functions(tree: ast.Module) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


def late_first_party_imports(tree: ast.Module) -> Iterator[ast.AST]:
    for function in functions(tree):
        for node in ast.walk(function):
            if isinstance(node, ast.Import):
                modules = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                modules = [node.module or ""]
            else:
                continue
            relative = isinstance(node, ast.ImportFrom) and node.level > 0
            if relative or any(module.split(".")[0] in FIRST_PARTY for module in modules):
                yield node


def long_functions(tree: ast.Module) -> Iterator[ast.AST]:
    for function in functions(tree):
        documented = ast.get_docstring(function) is not None and len(function.body) > 1
        first = function.body[1 if documented else 0]
        if function.body[-1].end_lineno - first.lineno + 1 > MAX_FUNCTION_LINES:
            yield function


def prints(tree: ast.Module) -> Iterator[ast.AST]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "print":
            yield node


def undocumented(tree: ast.Module) -> Iterator[ast.AST]:
    """Public functions, classes and methods without a docstring, and the module."""
    if tree.body and ast.get_docstring(tree) is None:
        yield ast.Pass(lineno=1)
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
    public = [node for node in classes if not node.name.startswith("_")]
    for node in (*tree.body, *(member for owner in public for member in owner.body)):
        named = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
        if not named or node.name.startswith("_") or ast.get_docstring(node) is not None:
            continue
        if not any(ast.unparse(decorator).endswith(".setter") for decorator in node.decorator_list):
            yield node  # a setter is documented by its property


def code_from_files(tree: ast.Module) -> Iterator[ast.AST]:
    """Whatever runs code that a data file contains."""
    unsafe = {"pickle", "cPickle", "cloudpickle", "dill", "joblib", "shelve"}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            if unsafe & {alias.name.split(".")[0] for alias in node.names}:
                yield node
        elif isinstance(node, ast.ImportFrom):
            if (node.module or "").split(".")[0] in unsafe:
                yield node
        elif isinstance(node, ast.Call):
            keywords = {k.arg: ast.unparse(k.value) for k in node.keywords}
            loads = ast.unparse(node.func) == "torch.load"
            if loads and keywords.get("weights_only") != "True":
                yield node
            if keywords.get("weights_only") == "False" or keywords.get("allow_pickle") == "True":
                yield node


LAWS = [
    pytest.param(
        late_first_party_imports, ALL_CODE, "def f():\n from pemirl_trl import optim", id="imports"
    ),
    pytest.param(
        long_functions, ALL_CODE, "def f():\n" + " x = 1\n" * (MAX_FUNCTION_LINES + 1), id="length"
    ),
    pytest.param(prints, LIBRARY, "print(1)", id="print"),
    pytest.param(
        undocumented, LIBRARY, '"""A."""\nclass A:\n """A."""\n def f(self): 1', id="docs"
    ),
    pytest.param(code_from_files, ALL_CODE, "torch.load(f, weights_only=False)", id="pickle"),
]


def sources(folders: tuple[str, ...]) -> list[Path]:
    return [path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))]


@pytest.mark.parametrize(("check", "folders", "offence"), LAWS)
def test_code_obeys(check: Check, folders: tuple[str, ...], offence: str):
    assert list(check(ast.parse(offence))), "this check does not see an offence"
    found = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in sources(folders)
        for node in check(ast.parse(path.read_text("utf-8")))
    ]
    assert not found


@pytest.mark.parametrize("package", ["pemirl_trl", "pemirl_lab", "pemirl_envs"])
def test_the_laws_are_about_every_package(package):
    assert any(package in path.parts for path in sources(LIBRARY))


def test_files_are_short():
    lengths = {path: len(path.read_text("utf-8").splitlines()) for path in sources(ALL_CODE)}
    assert sum(lengths.values()) > MAX_FILE_LINES, "the sources were not found"
    assert {path.name: n for path, n in lengths.items() if n > MAX_FILE_LINES} == {}


@pytest.mark.parametrize("package", [pemirl_trl, pemirl_envs])
def test_public_names_are_documented(package):
    public = {name: getattr(package, name) for name in package.__all__ if name != "__version__"}
    assert package.__doc__
    assert public
    # A dataclass without a docstring is given its signature.
    undocumented = [
        name
        for name, value in public.items()
        if inspect.isclass(value) or inspect.isroutine(value)
        if not value.__doc__ or value.__doc__.startswith(f"{name}(")
    ]
    assert undocumented == []


def direct_requirements() -> list[Requirement]:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    extras = project["optional-dependencies"].values()
    listed = [*project["dependencies"], *(line for extra in extras for line in extra)]
    return [r for r in map(Requirement, listed) if r.name != project["name"]]


def pins() -> dict[str, str]:
    lines = (ROOT / "constraints.txt").read_text("utf-8").splitlines()
    pinned = [line for line in lines if line and not line.startswith("#")]
    assert [line for line in pinned if not re.fullmatch(r"[\w.-]+==[\w.]+", line)] == []
    return {canonicalize_name(n): v for n, v in (line.split("==") for line in pinned)}


def test_every_direct_dependency_is_pinned_within_its_range():
    tested = pins()
    wrong = {
        str(requirement): tested.get(canonicalize_name(requirement.name), "no pin")
        for requirement in direct_requirements()
        if tested.get(canonicalize_name(requirement.name)) not in requirement.specifier
    }
    assert wrong == {}


def test_every_document_names_the_same_version():
    cited = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text("utf-8"), re.M)
    released = re.findall(r"^## \[(\d.*?)\]", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.M)
    assert cited[1] == pemirl_trl.__version__
    assert released[0] == pemirl_trl.__version__
    assert released == sorted(released, key=Version, reverse=True)
