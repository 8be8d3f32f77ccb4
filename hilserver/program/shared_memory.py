"""Where process images are, and whether one is in use, without any heavy import."""

import fcntl
import os
import re
from pathlib import Path
from typing import Final

from hilserver.errors import FailedError

FOLDER: Final = Path("/dev/shm")  # noqa: S108 -- POSIX shared memory on Linux
MADE_UP: Final = "auto"
"""Prefix of generated names, which no later daemon would ever take over."""
DEFAULT_IMAGE: Final = "robot"
_NAME: Final = re.compile(r"[A-Za-z0-9_.-]{1,100}")


def path_of(name: str) -> Path:
    """Return the file of the image `name`."""
    if not _NAME.fullmatch(name):
        raise FailedError(
            f"the image name {name!r} may hold letters, digits, '-', '_', '.' only"
        )
    return FOLDER / f"hilserver-{name}"


def in_use(name: str) -> FailedError:
    """Return the error for an image `name` that a running daemon uses."""
    return FailedError(
        f"another hilserver uses the process image '{name}'; stop it or set image.name"
    )


def check_free(name: str) -> None:
    """Raise FailedError if a running daemon uses the image `name`.

    Only an early check: it is repeated when the image is made.
    """
    if name == MADE_UP or not _NAME.fullmatch(name):
        return
    try:
        fd = os.open(
            path_of(name), os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
        )
    except OSError:
        return
    try:
        fcntl.flock(fd, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        raise in_use(name) from None
    finally:
        os.close(fd)


def made_up_in_use() -> list[str]:
    """Return the generated names of images that running daemons use."""
    found = []
    for path in sorted(FOLDER.glob(f"hilserver-{MADE_UP}-*")):
        name = path.name.removeprefix("hilserver-")
        try:
            check_free(name)
        except FailedError:
            found.append(name)
    return found
