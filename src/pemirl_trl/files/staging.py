"""Staging: what is written stands beside its destination until it is whole, then is renamed.

The name of a stage bears the mark of its owner, ``<machine>-<process>-<number>``. A process that
is killed leaves its stages behind; the next one that writes to the same place removes them, and
leaves alone those of a process that lives, or of another machine, about which it cannot know.
"""

from __future__ import annotations

import errno
import hashlib
import os
import platform
import re
import shutil
import stat
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = [
    "atomic_path",
    "content_digest",
    "expanded",
    "file_digest",
    "has_live_owner",
    "regular_file",
    "staging_folder",
    "writing",
]

_MACHINE = hashlib.sha256(platform.node().encode()).hexdigest()[:8]
_MARK = re.compile(r"(?P<machine>[0-9a-f]{8})-(?P<process>\d+)-(?P<number>[0-9a-f]{8})")
_mine: set[str] = set()  # the marks in use here: a new process may bear a dead one's number
_CURES = {
    errno.ENOSPC: "free some space on that disk, or choose another folder",
    errno.EDQUOT: "free some space within your quota, or choose another folder",
    errno.EFBIG: "raise the limit on the size of files (ulimit -f), or choose another disk",
    errno.EACCES: "change the permissions of its folder, or choose another one",
    errno.EPERM: "change the permissions of its folder, or choose another one",
    errno.EROFS: "that disk is read-only: choose another folder",
    errno.ENOTDIR: "part of its path is a file: choose another folder",
    errno.EEXIST: "part of its path is a file: choose another folder",
    errno.ENAMETOOLONG: "choose a shorter name",
}


def expanded(path: str | Path) -> Path:
    """``path`` with a leading ``~`` replaced by the home directory."""
    return Path(os.path.expanduser(path))


_DATA = (".json", ".parquet", ".arrow", ".hdf5")
_TYPES = {
    stat.S_IFDIR: "a directory",
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a character device",
    stat.S_IFBLK: "a block device",
}


def _refuse_unless_regular(path: Path, mode: int) -> None:
    if not stat.S_ISREG(mode):
        what = _TYPES.get(stat.S_IFMT(mode), "something else")
        raise ValueError(f"{path} is {what}; expected a regular file")


def regular_file(path: str | Path, kind: str = "regular") -> Path:
    """The path of a regular file to read, ``~`` expanded; symbolic links are followed.

    Opening a named pipe would wait for ever, reading a device might never end.

    Raises:
        FileNotFoundError: there is nothing at ``path``.
        ValueError: what is there is a directory, a pipe, a socket or a device.
    """
    path = expanded(path)
    try:
        mode = path.stat().st_mode
    except FileNotFoundError as error:
        raise FileNotFoundError(errno.ENOENT, f"no {kind} file", str(path)) from error
    _refuse_unless_regular(path, mode)
    return path


def file_digest(path: str | Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal; memory does not grow with the file.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it is not a regular file.
    """
    with regular_file(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def content_digest(path: str | Path) -> str:
    """SHA-256 of a file, or of a folder's files of data: their names and contents.

    Videos and pictures are left out: a folder of demonstrations may hold many gigabytes of them,
    which nobody reads here.

    Raises:
        FileNotFoundError: there is no such file or folder.
    """
    path = expanded(path)
    if not path.is_dir():
        return file_digest(path)
    content = hashlib.sha256()
    for file in sorted(path.rglob("*")):
        if file.is_file() and file.suffix in _DATA:
            content.update(f"{file.relative_to(path).as_posix()} {file_digest(file)}\n".encode())
    return content.hexdigest()


# --- whose stage it is -------------------------------------------------------------------------


@contextmanager
def _marked(prefix: str, suffix: str = "") -> Iterator[str]:
    """Yield the name of a stage, ``<prefix><mark><suffix>``, which is in use for this block."""
    mark = f"{_MACHINE}-{os.getpid()}-{uuid.uuid4().hex[:8]}"
    _mine.add(mark)
    try:
        yield f"{prefix}{mark}{suffix}"
    finally:
        _mine.discard(mark)


def has_live_owner(name: str) -> bool:
    """Whether a stage of this name may be in use: by a process that lives, or on another machine.

    A name without a mark has no owner.
    """
    mark = _MARK.search(name)
    if mark is None:
        return False
    if mark["machine"] != _MACHINE or os.name != "posix":
        return True  # other systems cannot ask about a process without touching it
    process = int(mark["process"])
    if process == os.getpid():
        return mark[0] in _mine
    try:
        os.kill(process, 0)  # sends nothing
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True  # another user's
    return True


# --- writing -----------------------------------------------------------------------------------


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Say of an OSError in this block which file could not be written, why, and what to do.

    Errors about files elsewhere pass as they are.

    Raises:
        OSError: of the same ``errno``, hence of the same class.
    """
    try:
        yield
    except OSError as error:
        if error.errno is None or not _concerns(error.filename, path):
            raise
        cure = _CURES.get(error.errno, "choose another folder")
        reason = os.strerror(error.errno)
        raise OSError(
            error.errno, f"not written, nothing was changed ({reason}): {cure}", str(path)
        ) from error


def _concerns(named: object, path: Path) -> bool:
    """Whether an error that names this file is about writing ``path``: its stage, or a folder."""
    if not isinstance(named, str):
        return True  # a write to an open file names none
    mark = _MARK.search(named)
    own = mark is not None and int(mark["process"]) == os.getpid()
    return own or Path(named) in (path, *path.parents)


def _destination(path: str | Path) -> tuple[Path, int | None]:
    """Where to write, with links followed, and the mode of the file that is there now, if any."""
    path = Path(os.path.realpath(expanded(path)))
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return path, None
    _refuse_unless_regular(path, mode)
    return path, stat.S_IMODE(mode)


def _mode_of_a_new_file(path: Path) -> int:
    """The mode that the umask and the folder give; the file is created and removed again."""
    path.touch(exist_ok=False)
    try:
        return stat.S_IMODE(path.stat().st_mode)
    finally:
        path.unlink()


def _remove_leftovers(path: Path) -> None:
    for sibling in path.parent.iterdir():
        name = sibling.name
        if name.startswith(f".{path.stem}.") and _MARK.search(name) and not has_live_owner(name):
            sibling.unlink(missing_ok=True)


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary sibling of ``path`` that replaces ``path`` once the block succeeds.

    A reader sees the old file or the new one, never half of one; an error leaves the old one. A
    symbolic link stays, and what it points to is replaced. The file keeps the mode that it had; a
    new one gets the umask's. The temporary name keeps the suffix, from which some writers take the
    format.

    Raises:
        OSError: it cannot be written; the message names the file and says what to do.
        ValueError: at ``path`` is a directory, a pipe or a device.
    """
    with writing(expanded(path)):
        path, mode = _destination(path)
    with writing(path), _marked(f".{path.stem}.", path.suffix) as name:
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_leftovers(path)
        temporary = path.with_name(name)
        mode = _mode_of_a_new_file(temporary) if mode is None else mode
        try:
            yield temporary
            with temporary.open("rb+") as file:
                os.fsync(file.fileno())
            temporary.chmod(mode)  # some writers make files that only their owner may read
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)


@contextmanager
def staging_folder(directory: Path, prefix: str) -> Iterator[Path]:
    """Yield a new folder ``<directory>/<prefix><mark>``; it goes, with all in it, after the block.

    What an earlier process left under ``prefix`` goes first.
    """
    directory.mkdir(parents=True, exist_ok=True)
    for leftover in directory.iterdir():
        if leftover.name.startswith(prefix) and not has_live_owner(leftover.name):
            shutil.rmtree(leftover, ignore_errors=True)
    with _marked(prefix) as name:
        folder = directory / name
        folder.mkdir()
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)
