"""The file behind the arena: /dev/shm, mode 0600, locked by its owner."""

import contextlib
import fcntl
import mmap
import os
import re
import time
from pathlib import Path

from hilserver.errors import FailedError

_FOLDER = Path("/dev/shm")  # noqa: S108 -- POSIX shared memory on Linux
MADE_UP = "auto"
"""First part of the names that nobody chose: nobody would ever take them over."""

_YOUNG_S = 60.0
_NAME = re.compile(r"[A-Za-z0-9_.-]{1,100}")
_OPEN_TRIES = 5


def path_of(name: str) -> Path:
    """Return the file of the image `name`."""
    if not _NAME.fullmatch(name):
        raise FailedError(f"the image name {name!r} may hold letters, digits, '-', '_', '.' only")
    return _FOLDER / f"hilserver-{name}"


def sweep(now_s: float | None = None) -> int:
    """Remove what killed daemons with made-up names left behind; return how many files.

    A file whose lock can be had has no owner any more. Young files are spared: their owner may be
    between making and locking them.
    """
    limit_s = (time.time() if now_s is None else now_s) - _YOUNG_S
    removed = 0
    for path in _FOLDER.glob(f"hilserver-{MADE_UP}-*"):
        with contextlib.suppress(OSError):
            if path.stat().st_mtime > limit_s:
                continue
            fd = os.open(path, os.O_RDWR | os.O_NOFOLLOW)
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
                path.unlink()
                removed += 1
            finally:
                os.close(fd)
    return removed


def _open_locked(path: Path) -> int:
    """Return a locked descriptor of `path`; one that its last owner removed meanwhile is no use."""
    for _ in range(_OPEN_TRIES):
        fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.fchmod(fd, 0o600)
            if os.fstat(fd).st_nlink > 0:
                return fd
        except BaseException:
            os.close(fd)
            raise
        os.close(fd)
    raise BlockingIOError


class SharedFile:
    """An owned, exclusively locked file in shared memory; removed by `close`.

    A file that a killed daemon left behind has no lock and is replaced.
    """

    def __init__(self, name: str, n_bytes: int) -> None:
        sweep()
        self.path = path_of(name)
        try:
            self._fd = _open_locked(self.path)
        except BlockingIOError:
            raise FailedError(
                f"another hilserver uses the process image '{name}'; stop it or set image.name"
            ) from None
        except OSError as error:
            reason = (error.strerror or "refused").lower()
            raise FailedError(
                f"cannot use {self.path}: {reason}; remove it or set image.name"
            ) from None
        try:
            os.ftruncate(self._fd, 0)
            # A hole would end in a bus error when shared memory is full.
            os.posix_fallocate(self._fd, 0, n_bytes)
            self.map = mmap.mmap(self._fd, n_bytes)
        except OSError as error:
            self.path.unlink(missing_ok=True)
            os.close(self._fd)
            reason = (error.strerror or "refused").lower()
            raise FailedError(
                f"the process image needs {n_bytes / 1e6:.0f} MB in {_FOLDER}: {reason};"
                " give it more (in a container --shm-size) or set a smaller image.ring_frames"
            ) from None

    def close(self) -> None:
        """Remove the file; views of the memory stay valid until they are dropped."""
        self.path.unlink(missing_ok=True)
        os.close(self._fd)
        with contextlib.suppress(BufferError):
            self.map.close()


def map_read_only(name: str) -> mmap.mmap:
    """Map the image of a running daemon for reading."""
    try:
        fd = os.open(path_of(name), os.O_RDONLY | os.O_NOFOLLOW)
    except OSError:
        raise FailedError(
            f"there is no process image '{name}'; is the daemon running under that image.name?"
        ) from None
    try:
        if os.fstat(fd).st_size < mmap.PAGESIZE:
            raise FailedError(f"the process image '{name}' is not complete; try again")
        return mmap.mmap(fd, 0, prot=mmap.PROT_READ)
    finally:
        os.close(fd)
