"""The pages of the API reference, written from every ``__all__`` before a build.

Each public name is documented once, at its home: the shortest module that exports it. A page is a
package; it begins with a table of its names and says where those live that it exports besides.
After the build every public name is looked up in the inventory: one that is missing is a warning,
which fails it.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import itertools
import pkgutil
import re
import sys
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

PACKAGES = ("pemirl_trl", "pemirl_envs", "pemirl_lab")
WITHOUT_ALL = ("pemirl_trl.optim.trainer", "pemirl_envs.rendering", "pemirl_lab.cli")
"""Modules to be imported by name, which say with their public definitions what they export."""


def public_names() -> dict[str, list[str]]:
    """What each public module exports, by the module's name."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # TorchRL's collectors and trainers warn at import
        exported = {module.__name__: list(module.__all__) for module in _modules_with_all()}
        for name in WITHOUT_ALL:
            defined = vars(importlib.import_module(name)).items()
            exported[name] = [
                key
                for key, value in defined
                if not key.startswith("_") and getattr(value, "__module__", None) == name
            ]
    return exported


def _modules_with_all() -> Iterator[ModuleType]:
    for top in PACKAGES:
        package = importlib.import_module(top)
        inside = pkgutil.walk_packages(package.__path__, f"{top}.")
        for name in (top, *(info.name for info in inside)):
            module = importlib.import_module(name)
            if hasattr(module, "__all__"):
                yield module


def homes(exported: Mapping[str, list[str]]) -> dict[str, str]:
    """Where each exported name is documented: ``module.name`` -> ``home.name``."""
    found: dict[tuple[str, int], str] = {}
    places: dict[str, str] = {}
    for module in sorted(exported, key=lambda name: name.count(".")):
        for name in exported[module]:
            thing = getattr(importlib.import_module(module), name)
            places[f"{module}.{name}"] = found.setdefault((name, id(thing)), f"{module}.{name}")
    return places


def pages() -> dict[str, str]:
    """The reference, in reStructuredText, by the name of a page."""
    exported = public_names()
    places = homes(exported)
    written: dict[str, str] = {}
    for module in sorted(exported):
        page = ".".join(module.split(".")[:2])
        here = [name for name in exported[module] if places[f"{module}.{name}"].startswith(module)]
        here = [name for name in here if places[f"{module}.{name}"] == f"{module}.{name}"]
        if here or module == page:
            if page not in written and module != page:  # a package that itself exports nothing
                written[page] = _title(page, "=") + _body(page, [], [])
            title = _title(module, "=" if page not in written else "-")
            elsewhere = [places[f"{module}.{n}"] for n in exported[module] if n not in here]
            written[page] = written.get(page, "") + title + _body(module, here, elsewhere)
    return written


def _title(text: str, underline: str) -> str:
    return f"\n{text}\n{underline * len(text)}\n\n"


def _body(module: str, here: list[str], elsewhere: list[str]) -> str:
    text = f".. automodule:: {module}\n   :no-members:\n\n"
    if elsewhere:
        links = ", ".join(f":py:obj:`~{name}`" for name in elsewhere)
        text += f"It also exports {links}.\n\n"
    if here:
        text += ".. list-table::\n   :widths: auto\n\n"
        text += "".join(_row(module, name) for name in here) + "\n"
    return text + "".join(_entry(module, name) for name in here)


def _row(module: str, name: str) -> str:
    """A line of a page's table: the name, and the first sentence that is said about it."""
    paragraph = " ".join(_documentation(module, name).split("\n\n")[0].split())
    sentence = re.split(r"(?<=[.:])\s", paragraph)[0]
    said = sentence if sentence.count("``") % 2 == 0 else paragraph
    return f"   * - :py:obj:`~{module}.{name}`\n     - {escaped(said)}\n"


def _entry(module: str, name: str) -> str:
    thing = getattr(importlib.import_module(module), name)
    if inspect.isclass(thing):
        return f".. autoclass:: {module}.{name}\n   :members:\n   :show-inheritance:\n\n"
    if inspect.isfunction(thing):
        return f".. autofunction:: {module}.{name}\n\n"
    text = escaped(_documentation(module, name)).replace("\n", "\n   ")
    return f".. py:data:: {name}\n   :module: {module}\n\n   {text}\n\n"


def _documentation(module: str, name: str) -> str:
    """The docstring; of a constant or an alias the string below its assignment, wherever that is.

    Raises:
        ValueError: there is none.
    """
    thing = getattr(importlib.import_module(module), name)
    if inspect.isclass(thing) or inspect.isfunction(thing):
        return inspect.getdoc(thing) or ""
    for defining in sorted(key for key in sys.modules if key.startswith(module)):
        same = getattr(sys.modules[defining], name, None) is thing
        if same and (said := _string_below(sys.modules[defining], name)):
            return said
    raise ValueError(f"{module}.{name} has no docstring: write one below its assignment")


def _string_below(module: ModuleType, name: str) -> str | None:
    body = ast.parse(inspect.getsource(module)).body
    for assignment, below in itertools.pairwise(body):
        targets = getattr(assignment, "targets", [getattr(assignment, "target", None)])
        if name in [getattr(target, "id", None) for target in targets]:
            match below:
                case ast.Expr(value=ast.Constant(value=str() as text)):
                    return inspect.cleandoc(text)
    return None


def escaped(text: str) -> str:
    """Bars are absolute values in these docstrings, never substitutions; literals stay."""
    parts = re.split(r"(``.*?``)", text, flags=re.DOTALL)
    return "".join(part if part.startswith("``") else part.replace("|", r"\|") for part in parts)


def escape_docstring(
    app: Sphinx, what: str, name: str, obj: Any, options: Any, lines: list[str]
) -> None:
    """What autodoc is given to say."""
    lines[:] = escaped("\n".join(lines)).split("\n")


def write(app: Sphinx) -> None:
    """Write the pages beside ``docs/api.md``; those of modules that are gone are removed."""
    folder = Path(app.confdir) / "api"
    folder.mkdir(exist_ok=True)
    written = pages()
    for name, text in written.items():
        file = folder / f"{name}.rst"
        if not file.exists() or file.read_text("utf-8") != text:
            file.write_text(text, "utf-8")
    for file in folder.glob("*.rst"):
        if file.stem not in written:
            file.unlink()


def check(app: Sphinx, exception: Exception | None) -> None:
    """Warn of every public name that has no entry."""
    from sphinx.util import logging  # here: a test writes the pages without Sphinx

    if exception is None:
        entries = app.env.domains.python_domain.objects
        for name, home in homes(public_names()).items():
            if home not in entries:
                logging.getLogger(__name__).warning("%s is not in the API reference", name)


def setup(app: Sphinx) -> dict[str, bool]:
    """Join the build."""
    app.connect("builder-inited", write)
    app.connect("autodoc-process-docstring", escape_docstring)
    app.connect("build-finished", check)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
