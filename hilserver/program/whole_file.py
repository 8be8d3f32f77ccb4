"""Files that appear whole or not at all, whatever ends the program that writes them."""

import contextlib
import errno
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

from hilserver.errors import FailedError, reason
from hilserver.small_file import sync_folder as sync_folder  # noqa: PLC0414 - for all who write files

PARTIAL = ".part"
_OPEN_FILES = ("/dev/std", "/dev/fd/", "/proc/")
"""How names of open files begin: ``/dev/stdout`` may be a plain file that others have open."""
_STAYS = {errno.EACCES, errno.EPERM, errno.EROFS, errno.EBUSY}
"""Errors of a folder or mount in which a file can be written to but not replaced."""


@contextlib.contextmanager
def whole(path: Path, suffix: str = PARTIAL) -> Iterator[Path]:
    """Give the path to write to; the file gets its name at the end, and is discarded on an error.

    A device or a pipe is written to directly, and a link stays one. Owner and mode are kept; what
    replaces a file is readable by nobody else until then. Only a file that cannot be replaced is
    written in place.

    Parameters
    ----------
    suffix : str
        Of the unfinished file, for writers that choose the format by it; by default no folder's
        listing takes it for a finished one.
    """
    if str(path.absolute()).startswith(_OPEN_FILES) or (
        path.exists() and not path.is_file()
    ):
        yield path
        return
    path = path.resolve()
    partial = path.with_name(f".{path.name}.{os.getpid()}{suffix}")
    if not _begun(partial, 0o600 if path.exists() else 0o666):
        yield path
        return
    try:
        yield partial
        with contextlib.suppress(
            OSError
        ):  # no such file yet, or a disk without owners and modes
            before = path.stat()
            partial.chmod(before.st_mode & 0o777)
            os.chown(partial, before.st_uid, before.st_gid)
        try:
            partial.replace(path)
        except OSError as error:
            if error.errno not in _STAYS or not path.exists():
                raise
            shutil.copyfile(partial, path)
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)


def _begun(partial: Path, mode: int) -> bool:
    """Make the file; return False if the folder does not allow it."""
    try:
        partial.touch(mode)
    except OSError as error:
        if error.errno in _STAYS:
            return False
        raise
    return True


@contextlib.contextmanager
def writing(path: Path, suffix: str = PARTIAL) -> Iterator[Path]:
    """Give the path to write a whole file to; FailedError if it cannot be written."""
    try:
        with whole(path, suffix) as partial:
            yield partial
    except OSError as error:
        raise FailedError(f"cannot write {path}: {reason(error)}") from None


def write_whole(path: Path, content: bytes) -> None:
    """Write a file that the disk holds, under its name, once this returns."""
    with whole(path) as partial, partial.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
    sync_folder(path.resolve().parent)
