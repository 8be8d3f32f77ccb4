"""The file behind the arena: /dev/shm, mode 0600, locked by its owner."""

import contextlib
import errno
import fcntl
import mmap
import os
import stat
import time
from pathlib import Path

from hilserver.errors import FailedError
from hilserver.program.guard import on_forced_end
from hilserver.program.shared_memory import FOLDER, MADE_UP, in_use, path_of

__all__ = ["MADE_UP", "OwnMemory", "SharedFile", "map_read_only", "path_of", "sweep"]

_YOUNG_S = 60.0
_OPEN_TRIES = 5


def sweep(now_s: float | None = None) -> int:
    """Remove files that killed daemons with made-up names left behind; return how many.

    A file that can be locked has no owner any more. Young files are spared, as their owner may have
    made them but not locked them yet.
    """
    limit_s = (time.time() if now_s is None else now_s) - _YOUNG_S
    removed = 0
    for path in FOLDER.glob(f"hilserver-{MADE_UP}-*"):
        with contextlib.suppress(OSError):
            if path.lstat().st_mtime <= limit_s:
                removed += _remove_left_behind(path)
    return removed


def _remove_left_behind(path: Path) -> bool:
    """Remove a file that a killed daemon of the same user left; return whether there was one.

    BlockingIOError if its owner is alive; PermissionError if it belongs to another user, who could
    otherwise read the memory of a daemon that adopts it.
    """
    try:
        fd = os.open(path, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except FileNotFoundError:
        return False
    try:
        found = os.fstat(fd)
        if not stat.S_ISREG(found.st_mode):
            raise OSError(errno.EINVAL, "is not a regular file")
        if found.st_uid != os.geteuid():
            raise PermissionError(
                errno.EPERM, f"belongs to another user (id {found.st_uid})"
            )
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # without a link it was removed meanwhile, and the path may be another daemon's new file
        if os.fstat(fd).st_nlink:
            path.unlink()
        return True
    finally:
        os.close(fd)


def _make_locked(path: Path) -> int:
    """Return a descriptor of a new, locked file at `path`; an existing one is never adopted."""
    for _ in range(_OPEN_TRIES):
        _remove_left_behind(path)
        with contextlib.suppress(FileExistsError, BlockingIOError):
            fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
            try:
                fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
                os.fchmod(fd, 0o600)  # whatever the umask is
                if os.fstat(fd).st_nlink > 0:
                    return fd
            except BaseException:
                os.close(fd)
                raise
            os.close(fd)
    raise BlockingIOError


class SharedFile:
    """An owned, exclusively locked file in shared memory; removed by `close`.

    A file that a killed daemon of the same user left behind is not locked and is replaced; any
    other existing file is refused.
    """

    def __init__(self, name: str, n_bytes: int) -> None:
        sweep()
        self.path = path_of(name)
        try:
            self._fd = _make_locked(self.path)
        except BlockingIOError:
            raise in_use(name) from None
        except OSError as error:
            reason = (error.strerror or "refused").lower()
            raise FailedError(
                f"cannot use {self.path}: {reason}; remove it or set image.name"
            ) from None
        self._revoke = on_forced_end(self.path.unlink)
        try:
            # writing to a hole would be a bus error if shared memory is full
            os.posix_fallocate(self._fd, 0, n_bytes)
            self.map = mmap.mmap(self._fd, n_bytes)
        except OSError as error:
            self._revoke()
            self.path.unlink(missing_ok=True)
            os.close(self._fd)
            reason = (error.strerror or "refused").lower()
            raise FailedError(
                f"the process image needs {n_bytes / 1e6:.0f} MB in {FOLDER}: {reason};"
                " give it more (in a container --shm-size) or set a smaller image.ring_frames"
            ) from None

    def close(self) -> None:
        """Remove the file; views of the memory stay valid until they are dropped."""
        self._revoke()
        self.path.unlink(missing_ok=True)
        os.close(self._fd)
        with contextlib.suppress(BufferError):
            self.map.close()


class OwnMemory:
    """Private memory, for an image that no other process reads."""

    def __init__(self, n_bytes: int) -> None:
        self.map = mmap.mmap(-1, n_bytes)

    def close(self) -> None:
        """Free the memory once no view of it is left."""
        with contextlib.suppress(BufferError):
            self.map.close()


def map_read_only(name: str) -> mmap.mmap:
    """Map the image of a running daemon for reading."""
    try:
        fd = os.open(path_of(name), os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        raise FailedError(
            f"there is no process image '{name}'; is the daemon running under that image.name?"
        ) from None
    try:
        found = os.fstat(fd)
        if os.geteuid() not in (0, found.st_uid) and found.st_uid != 0:
            raise FailedError(
                f"the process image '{name}' belongs to user {found.st_uid}"
            )
        if found.st_size < mmap.PAGESIZE:
            raise FailedError(f"the process image '{name}' is not complete; try again")
        return mmap.mmap(fd, 0, prot=mmap.PROT_READ)
    finally:
        os.close(fd)
