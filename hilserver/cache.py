"""The folder for results that programs would otherwise have to compute again.

It is a comfort and never a condition. Where it cannot be used, a folder of this user under the
system's temporary one stands in; where that cannot be used either, nothing is kept.
"""

import contextlib
import errno
import fcntl
import hashlib
import os
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Final

from hilserver.errors import reason

NOWHERE: Final = Path(os.devnull) / "hilserver"
"""A folder that does not exist on any computer."""

KERNELS: Final = "kernels-"
"""Begin of the name of a folder with compiled code; the hash of its sources follows."""

_MAGIC: Final = b"hilserver cache 1\n"
_DIGEST_BYTES: Final = 32
_ASK_AGAIN_S: Final = 0.02
_RECENT_S: Final = 86_400.0


def _print(sentence: str) -> None:
    print(f"hilserver: {sentence}", file=sys.stderr, flush=True)


tell: Callable[[str], None] = _print
"""Called once per process, with a sentence, where the cache cannot be used as it should."""


@contextlib.contextmanager
def reported_by(say: Callable[[str], None]) -> Iterator[None]:
    """Let `say` tell what is wrong with the cache, while the context lasts."""
    global tell  # noqa: PLW0603 - one per process
    before = tell
    tell = say
    try:
        yield
    finally:
        tell = before


def configured_folder() -> Path:
    """Return the folder of the whole cache, whether or not it can be used.

    Order: ``HILSERVER_CACHE_DIR``, systemd's ``CACHE_DIRECTORY``, ``XDG_CACHE_HOME``, ``~/.cache``.
    """
    given = os.environ.get("HILSERVER_CACHE_DIR") or os.environ.get("CACHE_DIRECTORY")
    if given:
        return Path(given)
    xdg = os.environ.get("XDG_CACHE_HOME")
    try:
        return Path(xdg or Path.home() / ".cache") / "hilserver"
    except RuntimeError:  # a user without a name and a home, as in some containers
        return NOWHERE


def spare_folder() -> Path:
    """Return the folder that stands in for the whole cache, whether or not it can be used."""
    # Not `tempfile.gettempdir`: its last resort is the current folder.
    return Path(os.environ.get("TMPDIR") or "/tmp") / f"hilserver-cache-{os.geteuid()}"  # noqa: S108


def cache_folder(name: str) -> Path:
    """Return a folder of the cache that nobody else can write to; whether we can is not sure.

    It is made if need be. The first one that can be used: within the configured folder, within the
    spare one, `NOWHERE`.
    """
    path = configured_folder() / name
    try:
        return _own(path)
    except OSError as error:
        spare = spare_of(name)
        _report(path.parent, error, spare)
        return spare


def spare_of(name: str, *, make: bool = True) -> Path:
    """Return a folder within the spare one that nobody else can write to, or `NOWHERE`."""
    base = spare_folder()
    try:
        if make:
            base.mkdir(mode=0o700, exist_ok=True)
        # Everybody can make this name: a link, or a folder of somebody else, is refused.
        found = base.lstat()
        if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.geteuid():
            return NOWHERE
        return _own(base / name, make=make)
    except OSError:
        return NOWHERE


_is_reported = False


def _report(folder: Path, error: OSError, spare: Path) -> None:
    """Say once why the configured folder cannot be used, what that costs, and how to cure it."""
    global _is_reported  # noqa: PLW0603 - once per process
    if _is_reported:
        return
    _is_reported = True
    if folder == NOWHERE:
        why = "there is no home folder"
    else:
        why = f"{folder}: {reason(error)}"
    cost = f"compiled code is kept in {spare.parent} until the computer restarts"
    if spare == NOWHERE:
        cost = "compiled code cannot be kept: each start compiles for a minute or two"
    cure = "set HILSERVER_CACHE_DIR to a folder that this user can write to, with 100 MB of space"
    tell(f"{why}; {cost}; {cure}")


def _own(path: Path, *, make: bool = True) -> Path:
    """Let nobody else write to `path`: its files are unpickled and executed."""
    if make:
        path.mkdir(parents=True, exist_ok=True, mode=0o700)
    found = path.stat()
    if found.st_uid not in (0, os.geteuid()):
        said = f"belongs to another user (id {found.st_uid})"
        raise PermissionError(errno.EPERM, said, str(path))
    if found.st_mode & 0o022:
        path.chmod(found.st_mode & ~0o022)
    return path


class Shelf:
    """Results by name in one folder of the cache, shared with other processes.

    What is damaged, or was written by somebody else, counts as absent. Nothing here raises.
    """

    def __init__(self, name: str) -> None:
        self._name = name
        self.folder = cache_folder(name)
        with contextlib.suppress(OSError):
            os.utime(self.folder)  # the last use, by which old folders are told apart
        self._is_full = False  # or read-only: what is new goes to the spare folder
        self._lock_file: int | None = None

    def get(self, name: str) -> bytes | None:
        """Return what was put under `name`, by any process."""
        found = whole(self.folder / name)
        if found is None:
            return whole(spare_of(self._name, make=False) / name)
        return found

    def put(self, name: str, data: bytes) -> None:
        """Keep `data`, whole or not at all, where there is room for it."""
        if not self._is_full:
            try:
                # somebody may have cleared the cache
                _write(_own(self.folder) / name, data)
            except OSError as error:
                self._is_full = True
                _report(self.folder.parent, error, self._in_spare(name, data))
        else:
            self._in_spare(name, data)

    def _in_spare(self, name: str, data: bytes) -> Path:
        """Keep `data` in the spare folder; return the folder, or `NOWHERE`."""
        spare = spare_of(self._name)
        try:
            _write(spare / name, data)
        except OSError:
            return NOWHERE
        return spare

    def wait_for(self, name: str, limit_s: float) -> None:
        """Claim `name` for this process, once no other process that made this claim has it.

        A claim ends with `let_go`, or with its process. Where the file system has no locks, or
        after `limit_s`, there is no claim, and two processes may do the same work.
        """
        end_s = time.monotonic() + limit_s
        while not self.claimed(name) and time.monotonic() < end_s:
            time.sleep(_ASK_AGAIN_S)

    def claimed(self, name: str) -> bool:
        """Claim `name` as `wait_for` does; return False if another process has it."""
        return self._locked(name, fcntl.LOCK_EX | fcntl.LOCK_NB)

    def let_go(self, name: str) -> None:
        """End a claim, if there is one."""
        self._locked(name, fcntl.LOCK_UN)

    def _locked(self, name: str, how: int) -> bool:
        """Lock or unlock the byte of a name in one file of all names; False: another has it."""
        place = int.from_bytes(hashlib.sha256(name.encode()).digest()[:4], "big")
        try:
            if self._lock_file is None:
                path = (spare_of(self._name) if self._is_full else self.folder) / "lock"
                self._lock_file = os.open(
                    path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600
                )
            fcntl.lockf(self._lock_file, how, 1, place)
        except OSError as error:  # all but the first two: no such file, no locks
            return error.errno not in (errno.EACCES, errno.EAGAIN)
        return True


def remove_old(prefix: str, keep: int) -> None:
    """Remove the folders of the cache that begin with `prefix`, but for the last ones used.

    One that was used within a day stays, too: others may work with several versions by turns.
    """
    for base in (configured_folder(), spare_folder()):
        with contextlib.suppress(OSError):
            used = [
                (path.stat().st_mtime, path)
                for path in base.iterdir()
                if path.name.startswith(prefix)
            ]
            for used_s, path in sorted(used, reverse=True)[keep:]:
                if used_s < time.time() - _RECENT_S:
                    shutil.rmtree(path, ignore_errors=True)


def whole(path: Path) -> bytes | None:
    """Return what a `Shelf` put into a file, if it is this user's or root's, and undamaged."""
    try:
        with path.open("rb") as file:
            if os.fstat(file.fileno()).st_uid not in (0, os.geteuid()):
                return None
            kept = file.read()
    except OSError:
        return None
    start = len(_MAGIC) + _DIGEST_BYTES
    digest = kept[len(_MAGIC) : start]
    data = kept[start:]
    is_whole = kept.startswith(_MAGIC) and hashlib.sha256(data).digest() == digest
    return data if is_whole else None


def _write(path: Path, data: bytes) -> None:
    """Write a file that other processes see only when it is whole."""
    handle, unfinished = tempfile.mkstemp(
        dir=path.parent, prefix=path.stem, suffix=".part"
    )
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(_MAGIC + hashlib.sha256(data).digest() + data)
        Path(unfinished).replace(path)
    except OSError:
        Path(unfinished).unlink(missing_ok=True)
        raise
