"""What is written is whole or absent, in the right place, with the right mode; stages are owned."""

import errno
import hashlib
import os
import resource
import signal
import socket
import stat
import subprocess
import sys
from pathlib import Path

import pytest

from pemirl_trl.files import atomic_path, file_digest, regular_file
from pemirl_trl.files.staging import _MACHINE, has_live_owner, staging_folder


def write(path, text="new"):
    with atomic_path(path) as temporary:
        temporary.write_text(text)


def mode(path):
    return stat.S_IMODE(path.stat().st_mode)


def test_replaces_whole_or_not_at_all(tmp_path):
    target = tmp_path / "deep" / "a.json"
    write(target, "old")

    def fail_half_way():
        with atomic_path(target) as temporary:
            temporary.write_text("half")
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail_half_way()
    assert target.read_text() == "old"
    assert [p.name for p in target.parent.iterdir()] == ["a.json"]


@pytest.mark.parametrize("umask", [0o022, 0o077, 0o002])
def test_a_new_file_has_the_umask_s_mode_whatever_its_writer_does(tmp_path, umask):
    before = os.umask(umask)
    try:
        with atomic_path(tmp_path / "a") as temporary:
            temporary.write_text("x")
            temporary.chmod(0o600)  # as tempfile does
    finally:
        os.umask(before)
    assert mode(tmp_path / "a") == 0o666 & ~umask


def test_an_existing_file_keeps_its_mode(tmp_path):
    target = tmp_path / "a"
    target.write_text("old")
    target.chmod(0o640)
    write(target)
    assert (target.read_text(), mode(target)) == ("new", 0o640)


def test_a_symbolic_link_stays_and_its_target_is_replaced(tmp_path):
    (tmp_path / "real").mkdir()
    target, link = tmp_path / "real" / "a", tmp_path / "link"
    link.symlink_to(target)
    for text in ("first", "second"):  # first the link dangles
        write(link, text)
        assert link.is_symlink()
        assert target.read_text() == text


def test_home_is_expanded(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    write("~/a")
    assert (tmp_path / "a").read_text() == "new"
    assert file_digest("~/a") == hashlib.sha256(b"new").hexdigest()


def make_socket(path):
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(path))


@pytest.mark.parametrize(
    ("make", "what"),
    [(Path.mkdir, "a directory"), (os.mkfifo, "a named pipe"), (make_socket, "a socket")],
)
@pytest.mark.parametrize("use", [write, regular_file, file_digest])
def test_what_is_no_file_is_refused_at_once(tmp_path, make, what, use, monkeypatch):
    monkeypatch.chdir(tmp_path)  # a socket's path must be short
    make(Path("a"))
    with pytest.raises(ValueError, match=f"a is {what}; expected a regular file"):
        use(Path("a"))
    assert [p.name for p in tmp_path.iterdir()] == ["a"]


def test_a_device_is_refused():
    with pytest.raises(ValueError, match="/dev/null is a character device"):
        write("/dev/null")
    with pytest.raises(ValueError, match="/dev/zero is a character device"):
        file_digest("/dev/zero")


def test_digest_is_that_of_the_bytes(tmp_path):
    (tmp_path / "a").write_bytes(bytes(range(256)) * 9000)
    assert file_digest(tmp_path / "a") == hashlib.sha256(bytes(range(256)) * 9000).hexdigest()
    with pytest.raises(FileNotFoundError, match="no regular file"):
        file_digest(tmp_path / "b")


# --- what cannot be written --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "cure"),
    [
        (errno.ENOSPC, "free some space"),
        (errno.EDQUOT, "quota"),
        (errno.EACCES, "change the permissions"),
        (errno.EROFS, "read-only: choose another folder"),
    ],
)
def test_an_error_names_the_file_and_the_cure(tmp_path, number, cure):
    (tmp_path / "a").write_text("old")

    def fail(named):
        with atomic_path(tmp_path / "a") as temporary:
            temporary.write_text("ha")
            raise OSError(number, os.strerror(number), *([str(temporary)] if named else []))

    for named in (True, False):
        with pytest.raises(OSError, match=cure) as raised:
            fail(named)
        assert raised.value.errno == number
        assert raised.value.filename == str(tmp_path / "a")
        assert os.strerror(number) in str(raised.value)
    assert (tmp_path / "a").read_text() == "old"
    assert len(list(tmp_path.iterdir())) == 1


def test_a_file_that_outgrows_a_limit_leaves_nothing_behind(tmp_path):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, limits[1]))
    try:
        with pytest.raises(OSError, match="ulimit") as raised:
            write(tmp_path / "a", "x" * 100_000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert raised.value.errno == errno.EFBIG
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_is_a_file_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match=r"part of its path is a file.*'.*/file/a'"):
        write(tmp_path / "file" / "a")
    with pytest.raises(OSError, match=r"part of its path is a file.*'.*/file/b/a'"):
        write(tmp_path / "file" / "b" / "a")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_an_unwritable_folder_is_named(tmp_path):
    tmp_path.chmod(0o500)
    with pytest.raises(PermissionError, match="change the permissions"):
        write(tmp_path / "a")


def test_errors_about_other_files_pass_as_they_are(tmp_path):
    def read_another():
        with atomic_path(tmp_path / "a"):
            (tmp_path / "input").read_text()

    with pytest.raises(FileNotFoundError) as raised:
        read_another()
    assert raised.value.filename == str(tmp_path / "input")


# --- whose stage it is -------------------------------------------------------------------------

KILLED = """
import os, signal, sys
from pemirl_trl.files import atomic_path
with atomic_path(sys.argv[1]) as temporary:
    temporary.write_text("half")
    print("staged", flush=True)
    signal.pause()
"""


def test_what_a_killed_process_left_is_removed_by_the_next_and_not_before(tmp_path):
    target = tmp_path / "a.json"
    path = os.pathsep.join(filter(None, sys.path))
    with subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", KILLED, str(target)],
        env={**os.environ, "PYTHONPATH": path},
        stdout=subprocess.PIPE,
    ) as process:
        assert process.stdout.readline() == b"staged\n"
        write(target, "while it lives")
        assert len(list(tmp_path.iterdir())) == 2
        process.send_signal(signal.SIGKILL)
        process.wait()
    assert len(list(tmp_path.iterdir())) == 2
    write(target)
    assert [p.name for p in tmp_path.iterdir()] == ["a.json"]


def test_only_a_dead_owner_s_stage_is_a_leftover():
    with subprocess.Popen([sys.executable, "-c", ""]) as process:
        pass  # over, and waited for
    assert not has_live_owner(f".a.{_MACHINE}-{process.pid}-0123abcd.json")
    assert has_live_owner(f".a.{_MACHINE}-{os.getppid()}-0123abcd.json")
    assert has_live_owner(".a.00000000-1-0123abcd.json")  # another machine's
    # A process in a container is often given the number of the one that was killed.
    assert not has_live_owner(f".a.{_MACHINE}-{os.getpid()}-0123abcd.json")
    assert not has_live_owner(f".a.{_MACHINE}-{10**30}-0123abcd.json")
    assert not has_live_owner(".checkpoint-3.stage")


def test_other_files_leftovers_stay(tmp_path):
    other = tmp_path / f".b.{_MACHINE}-{os.getpid()}-0123abcd"
    similar = tmp_path / ".a.notes"
    for path in (other, similar):
        path.write_text("")
    write(tmp_path / "a")
    assert {p.name for p in tmp_path.iterdir()} == {"a", other.name, similar.name}


def test_a_staging_folder_goes_with_all_in_it(tmp_path):
    (tmp_path / ".run-old" / "deep").mkdir(parents=True)
    with staging_folder(tmp_path, ".run-") as outer:
        (outer / "a").write_text("")
        with staging_folder(tmp_path, ".run-") as inner:
            assert {p.name for p in tmp_path.iterdir()} == {outer.name, inner.name}
    assert list(tmp_path.iterdir()) == []
