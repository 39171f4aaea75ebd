"""Where files are looked for."""

from __future__ import annotations

from pathlib import Path

from pemirl_trl.data.formats import located


class RunRefused(ValueError):  # noqa: N818 (it says what happened)
    """A run that cannot begin or go on as it was asked for; the message says what to do."""


PACKAGE = Path(__file__).resolve().parents[1]
CHECKOUT = PACKAGE.parents[1]
"""The repository, where the package runs from one."""


def data_file(name: str | Path) -> Path:
    """A path as given; or, for ``data/...``, the file of the wheel, or of the checkout.

    A folder is one too where demonstrations lie in one, and ``minari:NAME`` is the folder that
    Minari keeps them in.

    Raises:
        FileNotFoundError: it is in none of these places; names them.
    """
    given = located(name)
    candidates = [given]
    if not given.is_absolute():
        candidates += [PACKAGE / given, CHECKOUT / given]
    for candidate in candidates:
        if candidate.exists():
            return candidate
    places = ", ".join(str(place) for place in candidates)
    raise FileNotFoundError(
        f"no file {name} (looked at {places}). The package itself brings Point-Maze's "
        "data; those of the other domains are in a checkout of the repository: run from there, or "
        "give a path"
    )


def run_file(name: str | Path, written_by: str) -> Path:
    """A file of an earlier run, from the working directory alone: that is where runs write.

    Raises:
        FileNotFoundError: it is not there; says which command writes it.
    """
    path = Path(name).expanduser()
    if not path.is_file():
        raise FileNotFoundError(f"no file {path.absolute()}: pemirl {written_by} writes it")
    return path
