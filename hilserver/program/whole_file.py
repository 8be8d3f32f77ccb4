"""Files that appear whole or not at all, whatever ends the program that writes them."""

import contextlib
import errno
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

_OPEN_FILES = ("/dev/std", "/dev/fd/", "/proc/")
"""How names of open files begin: ``/dev/stdout`` may lead to a plain file that others hold."""
_STAYS = {errno.EACCES, errno.EPERM, errno.EROFS, errno.EBUSY}
"""Errors of a folder, or of a mount, in which a file may be written to and not replaced."""


@contextlib.contextmanager
def whole(path: Path) -> Iterator[Path]:
    """Give the path to write to; at the end the file has its name, after an error there is none.

    A device or a pipe is written to as it is, and a link stays one. Owner and mode stay. Only a
    file that cannot be replaced is written in place.
    """
    if str(path.absolute()).startswith(_OPEN_FILES) or (path.exists() and not path.is_file()):
        yield path
        return
    path = path.resolve()
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")
    if path.exists() and not _begun(partial):
        yield path
        return
    try:
        yield partial
        _replace(path, partial)
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)


def _begun(partial: Path) -> bool:
    """Make the file, for nobody else to read yet; return False where the folder takes none."""
    try:
        partial.touch(0o600)
    except OSError as error:
        if error.errno in _STAYS:
            return False
        raise
    return True


def _replace(path: Path, partial: Path) -> None:
    with contextlib.suppress(OSError):  # not there yet, or a disk without owners and modes
        before = path.stat()
        partial.chmod(before.st_mode & 0o777)
        os.chown(partial, before.st_uid, before.st_gid)
    try:
        partial.replace(path)
    except OSError as error:
        if error.errno not in _STAYS or not path.exists():
            raise
        shutil.copyfile(partial, path)


def write_whole(path: Path, content: bytes) -> None:
    """Write a file and hand it to the disk before it gets its name."""
    with whole(path) as partial, partial.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())
