"""Small files that a user names, read whole; a pipe or an endless device cannot block us."""

import errno
import os
import stat
from pathlib import Path

LARGEST = 1_000_000


def read_small(path: Path, most_bytes: int = LARGEST) -> bytes:
    """Return a file's content; OSError if it is not regular or larger than `most_bytes`."""
    fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    with os.fdopen(fd, "rb") as file:
        if not stat.S_ISREG(os.fstat(fd).st_mode):
            raise OSError(errno.EINVAL, "it is not a regular file", str(path))
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:
        raise OSError(errno.EFBIG, f"it is larger than {most_bytes} bytes", str(path))
    return content
