"""Where process images lie, and whether one is in use; known before anything heavy is imported."""

import fcntl
import os
import re
from pathlib import Path
from typing import Final

from hilserver.errors import FailedError

FOLDER: Final = Path("/dev/shm")  # noqa: S108 -- POSIX shared memory on Linux
MADE_UP: Final = "auto"
"""First part of the names that nobody chose: nobody would ever take them over."""
DEFAULT_IMAGE: Final = "robot"
_NAME: Final = re.compile(r"[A-Za-z0-9_.-]{1,100}")


def path_of(name: str) -> Path:
    """Return the file of the image `name`."""
    if not _NAME.fullmatch(name):
        raise FailedError(f"the image name {name!r} may hold letters, digits, '-', '_', '.' only")
    return FOLDER / f"hilserver-{name}"


def in_use(name: str) -> FailedError:
    """Return what is said when a living daemon has the image `name`."""
    return FailedError(
        f"another hilserver uses the process image '{name}'; stop it or set image.name"
    )


def check_free(name: str) -> None:
    """Refuse the name of an image that a living daemon has; whoever makes it looks again.

    FailedError if it is in use.
    """
    if name == MADE_UP or not _NAME.fullmatch(name):
        return
    try:
        fd = os.open(path_of(name), os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return
    try:
        fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        raise in_use(name) from None
    finally:
        os.close(fd)
