"""What every writer of recordings provides, and the file that all of them write to."""

import errno
import fcntl
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hilserver.image import FrameBatch
from hilserver.logs.log import Change, RecordedState


@dataclass(frozen=True, slots=True)
class Segmented:
    """Frames with the segment of each, and the changes in them, as writers take them."""

    frames: FrameBatch
    segments: NDArray[np.int64]
    changes: Sequence[Change] = ()


class LogWriter(Protocol):
    """Writes one file; after `flush`, a killed process loses nothing written before."""

    @property
    def n_bytes(self) -> int:
        """Size of the file so far."""

    def write(self, batch: Segmented) -> None:
        """Append frames and changes."""

    def add_state(self, state: RecordedState) -> None:
        """Append a state to replay from."""

    def tell(self, run: Mapping[str, Any]) -> None:
        """Replace what the file says about its run."""

    def flush(self) -> None:
        """Hand everything to the operating system."""

    def sync(self) -> None:
        """Hand everything to the disk."""

    def close(self) -> None:
        """Complete the file."""


def size_of(path: Path) -> int:
    """Return the size of a file, or of all files in a folder [bytes]; 0 if it is gone."""
    try:
        files = list(path.iterdir()) if path.is_dir() else [path]
        return sum(file.stat().st_size for file in files)
    except OSError:
        return 0


class WholeFile:
    """A file that only ever ends behind something whole.

    What could not be written to its end (disk full) is cut off again, so that a reader never meets
    half a record, unless the process was killed in the middle of a write. It is ours alone until it
    is closed; OSError where another program, or a second recorder, writes it.
    """

    def __init__(self, path: Path) -> None:
        self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o640)
        self.size = 0
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            self.close()
            raise OSError(
                errno.EBUSY, "another program is writing to it; choose another name"
            ) from None
        except OSError:
            pass  # a file system without locks
        if os.fstat(self._fd).st_size:
            os.ftruncate(self._fd, 0)

    def append(self, data: bytes) -> None:
        """Write all of `data` or, with an OSError, none of it."""
        view = memoryview(data)
        done = 0
        try:
            while done < len(view):
                done += os.write(self._fd, view[done:])
        except OSError:
            self.cut(self.size)
            raise
        self.size += done

    def cut(self, size: int) -> None:
        """Cut the file off behind `size` bytes."""
        os.ftruncate(self._fd, size)
        os.lseek(self._fd, size, os.SEEK_SET)
        self.size = size

    def sync(self) -> None:
        """Hand everything to the disk."""
        os.fdatasync(self._fd)

    def close(self) -> None:
        """Close it; twice does no harm."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1
