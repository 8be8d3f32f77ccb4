"""Small files: read whole, without waiting for a pipe; and new names that the disk holds."""

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


def sync_folder(folder: Path) -> None:
    """Let the disk hold the names in a folder: after a loss of power, a new one is there."""
    try:
        fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except PermissionError:  # one may be allowed to write there, but not to look
        return
    try:
        os.fsync(fd)
    except OSError as error:
        if error.errno != errno.EINVAL:  # a disk that cannot do this for folders
            raise
    finally:
        os.close(fd)
