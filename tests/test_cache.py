"""The cache in every state that a folder can be in: it is a comfort and never a condition."""

import errno
import fcntl
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from hilserver import cache
from hilserver.cache import NOWHERE, Shelf, cache_folder, remove_old

NOBODY = 65534
LARGE = 1 << 16

AS_A_USER = f"""
import os, resource, sys
from hilserver.cache import Shelf, cache_folder
if os.getuid() == 0:  # to whom nothing is read-only
    os.setgroups([]), os.setgid({NOBODY}), os.setuid({NOBODY})
if 'full' in sys.argv:
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
shelf = Shelf('kernels-1')
print(shelf.get('old'))
for name in ('new', 'newer'):
    shelf.wait_for(name, 1.0)
    shelf.put(name, bytes({LARGE}) if 'full' in sys.argv else name.encode())
    shelf.let_go(name)
print(Shelf('kernels-1').get('newer'))
"""


@pytest.fixture
def tmp_path():
    """Return a folder that other users can reach; every start of pytest shuts its own to them."""
    with tempfile.TemporaryDirectory(
        prefix="test-", ignore_cleanup_errors=True
    ) as name:
        Path(name).chmod(0o755)
        yield Path(name)


@pytest.fixture
def own(tmp_path, monkeypatch):
    """Return a configured folder that is not made yet, with a spare one beside it."""
    monkeypatch.setenv("HILSERVER_CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setenv("TMPDIR", str(tmp_path / "tmp"))
    monkeypatch.setattr(cache, "_is_reported", False)
    (tmp_path / "tmp").mkdir()
    return tmp_path / "cache"


def as_a_user(tmp_path, *words, **environment):
    """Return what a user without privileges finds, and the lines that this user is told."""
    (tmp_path / "tmp").chmod(0o1777)
    given = {"TMPDIR": str(tmp_path / "tmp"), "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", AS_A_USER, *words],
        capture_output=True,
        text=True,
        check=True,
        env=given | environment,
    )
    return done.stdout.split(), done.stderr.splitlines()


def filled(folder):
    """Fill a cache of this user and make it read-only for everybody."""
    Shelf("kernels-1").put("old", b"old")
    for path in (folder, folder / "kernels-1"):
        path.chmod(0o555)
    (folder / "kernels-1" / "old").chmod(0o444)


def test_what_is_put_is_found_and_nobody_is_told(own, capfd):
    Shelf("kernels-1").put("a", b"1")
    assert Shelf("kernels-1").get("a") == b"1"
    assert Shelf("kernels-1").get("b") is None
    assert capfd.readouterr() == ("", "")
    assert not (own.parent / "tmp" / f"hilserver-cache-{os.geteuid()}").exists()


@pytest.mark.parametrize(
    ("make", "why"),
    [
        (lambda folder: folder.touch(), "not a directory"),
        (lambda folder: folder.mkdir(mode=0o555), "permission denied"),
    ],
    ids=["a file", "not writable"],
)
def test_a_folder_that_cannot_be_made_is_one_line_and_the_spare_one_is_used(
    own, tmp_path, make, why
):
    make(own)
    (absent, found), [line] = as_a_user(tmp_path, HILSERVER_CACHE_DIR=str(own))
    assert (absent, found) == ("None", "b'newer'")
    assert line.startswith(
        f"hilserver: {own}: {why}; compiled code is kept in {tmp_path}/tmp/hil"
    )
    assert "set HILSERVER_CACHE_DIR" in line


def test_a_home_that_does_not_exist_is_one_line(tmp_path):
    (tmp_path / "tmp").mkdir()
    (_, found), [line] = as_a_user(tmp_path, HOME="/nonexistent")
    assert found == "b'newer'"
    assert "/nonexistent/.cache/hilserver" in line


def test_a_user_without_home_and_name_has_the_spare_folder(own, monkeypatch, capfd):
    def unknown(_):
        raise RuntimeError("Could not determine home directory.")

    for name in ("HILSERVER_CACHE_DIR", "CACHE_DIRECTORY", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(Path, "home", classmethod(unknown))
    assert cache_folder("kernels-1").is_relative_to(own.parent / "tmp")
    assert capfd.readouterr().err.startswith(
        "hilserver: there is no home folder; compiled code"
    )


def test_a_complete_cache_that_is_read_only_is_used_without_a_word(
    own, tmp_path, monkeypatch
):
    monkeypatch.setattr(
        "tests.test_cache.AS_A_USER", AS_A_USER.partition("for name")[0]
    )
    filled(own)
    assert as_a_user(tmp_path, HILSERVER_CACHE_DIR=str(own)) == (["b'old'"], [])


def test_what_a_read_only_cache_lacks_goes_to_the_spare_folder(own, tmp_path):
    filled(own)
    (old, new), [line] = as_a_user(tmp_path, HILSERVER_CACHE_DIR=str(own))
    assert (old, new) == ("b'old'", "b'newer'")
    assert "permission denied; compiled code is kept in" in line


def test_a_full_disk_is_one_line_and_nothing_half_written_stays(own, tmp_path):
    (_, new), [line] = as_a_user(
        tmp_path, "full", HILSERVER_CACHE_DIR=str(tmp_path / "tmp/c")
    )
    assert new == "None"
    assert "no space left; free some; compiled code cannot be kept: each start" in line
    left = {path.name for path in (tmp_path / "tmp").rglob("*") if path.is_file()}
    assert left == {"lock"}


def test_a_cache_of_another_user_is_not_read(own, tmp_path):
    """Its files are unpickled."""
    own.mkdir()
    Shelf("kernels-1").put("old", b"theirs")
    if os.getuid() == 0:
        os.chown(own / "kernels-1", NOBODY + 1, -1)
        (absent, new), [line] = as_a_user(tmp_path, HILSERVER_CACHE_DIR=str(own))
        assert (absent, new) == ("None", "b'newer'")
        assert f"belongs to another user (id {NOBODY + 1})" in line


def test_a_file_of_another_user_is_not_read(own, monkeypatch):
    """It may have come in before nobody else could write to the folder."""
    Shelf("kernels-1").put("a", b"theirs")
    found = Shelf("kernels-1")
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    if os.getuid() == 0:
        os.chown(own / "kernels-1" / "a", NOBODY, -1)
    assert found.get("a") is None


@pytest.mark.parametrize("kind", ["link", "file", "theirs"])
def test_a_spare_folder_that_somebody_else_made_is_refused(
    own, tmp_path, monkeypatch, kind
):
    """Everybody can write to the temporary folder, and knows the name."""
    own.touch()
    spare, elsewhere = cache.spare_folder(), tmp_path / "elsewhere"
    elsewhere.mkdir()
    if kind == "link":
        spare.symlink_to(elsewhere)
    elif kind == "file":
        spare.touch()
    else:
        spare.mkdir()
        monkeypatch.setattr(os, "geteuid", lambda: NOBODY)
        monkeypatch.setattr(cache, "spare_folder", lambda: spare)
    assert cache_folder("kernels-1") == NOWHERE
    Shelf("kernels-1").put("a", b"1")
    assert Shelf("kernels-1").get("a") is None
    assert not list(elsewhere.iterdir())


def test_nobody_else_may_write_to_the_cache(own):
    folder = cache_folder("kernels-1")
    folder.chmod(0o777)
    assert cache_folder("kernels-1").stat().st_mode & 0o777 == 0o755


@pytest.mark.parametrize(
    "damage",
    [
        lambda b: b[:-1],
        lambda b: b"",
        lambda b: b[:-3] + b"?" + b[-2:],
        lambda b: b[5:],
    ],
)
def test_a_damaged_file_counts_as_absent(own, damage):
    Shelf("kernels-1").put("a", b"0123456789")
    path = own / "kernels-1" / "a"
    path.write_bytes(damage(path.read_bytes()))
    assert Shelf("kernels-1").get("a") is None


def test_a_process_that_is_killed_while_it_writes_leaves_no_half_file(own):
    program = (
        "import os, signal; from hilserver import cache; Path = cache.Path;"
        "Path.replace = lambda *_: os.kill(os.getpid(), signal.SIGKILL);"
        "cache.Shelf('kernels-1').put('a', b'1')"
    )
    subprocess.run([sys.executable, "-c", program], check=False)
    assert Shelf("kernels-1").get("a") is None
    Shelf("kernels-1").put("a", b"2")
    assert Shelf("kernels-1").get("a") == b"2"


def test_a_cache_that_is_cleared_while_it_is_in_use_is_made_again(own, capfd):
    shelf = Shelf("kernels-1")
    (own / "kernels-1").rmdir()
    shelf.put("a", b"1")
    assert shelf.get("a") == b"1"
    assert capfd.readouterr().err == ""


CLAIMING = (
    "import sys; from hilserver.cache import Shelf; s = Shelf('kernels-1');"
    "print(s.claimed('a'), flush=True); sys.stdin.read()"
)


def test_another_process_waits_for_a_claim_no_longer_than_its_limit(own):
    shelf, command = Shelf("kernels-1"), [sys.executable, "-c", CLAIMING]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **pipes) as other:
        assert other.stdout.readline() == "True\n"
        assert not shelf.claimed("a")
        assert shelf.claimed("b")
        shelf.wait_for("a", 0.05)
        other.kill()  # its claims end with it
    shelf.wait_for("a", 10.0)
    assert shelf.claimed("a")


def test_on_a_file_system_without_locks_nobody_waits(own, monkeypatch):
    def refused(*_):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "lockf", refused)
    assert Shelf("kernels-1").claimed("a")


def test_old_folders_are_removed_and_others_are_not(own):
    for age_s in range(5):
        path = cache_folder(f"kernels-{age_s}")
        os.utime(path, (1e9 - age_s, 1e9 - age_s))
    cache_folder("opcua")
    remove_old("kernels-", 2)
    assert {path.name for path in own.iterdir()} == {"kernels-0", "kernels-1", "opcua"}
    for number in range(3):
        cache_folder(f"kernels-new{number}")
    remove_old("kernels-", 2)
    assert len(list(own.iterdir())) == 4
