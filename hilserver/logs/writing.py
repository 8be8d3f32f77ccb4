"""What every writer of recordings does, and how one is chosen."""

import errno
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from hilserver.errors import FailedError
from hilserver.image import FrameBatch
from hilserver.logs.log import State

SUFFIXES = (".mcap", ".csv")


@dataclass(frozen=True, slots=True)
class Segmented:
    """Frames with the segment each belongs to; what writers take."""

    frames: FrameBatch
    segments: NDArray[np.int64]


class LogWriter(Protocol):
    """Writes one file; after `flush` a killed process loses nothing that was written before."""

    @property
    def n_bytes(self) -> int:
        """Size of the file so far."""

    def write(self, batch: Segmented) -> None:
        """Append frames."""

    def add_state(self, state: State) -> None:
        """Append a state to replay from."""

    def tell(self, run: Mapping[str, Any]) -> None:
        """Replace what the file says about its run."""

    def flush(self) -> None:
        """Hand everything to the operating system."""

    def sync(self) -> None:
        """Hand everything to the disk."""

    def close(self) -> None:
        """Complete the file."""


def open_writer(
    path: Path, run: Mapping[str, Any], slots: Sequence[int], utc_minus_monotonic_ns: int = 0
) -> LogWriter:
    """Begin a log; the suffix chooses the format.

    Parameters
    ----------
    run : mapping
        See `provenance.make_run`.
    slots : sequence of int
        Slots of the signals to write, rising.
    utc_minus_monotonic_ns : int
        Turns the frames' planned starts into UTC.

    Raises
    ------
    FailedError
        If the file cannot be made.
    """
    from hilserver.logs.csv_writer import CsvWriter  # noqa: PLC0415 -- they build on this module
    from hilserver.logs.mcap_writer import McapWriter  # noqa: PLC0415

    check_suffix(path)
    try:
        if path.suffix == ".csv":
            return CsvWriter(path, run, slots)
        return McapWriter(path, run, slots, utc_minus_monotonic_ns)
    except OSError as error:
        raise FailedError(f"{path}: cannot be written: {reason(error)}") from None


def check_suffix(path: Path) -> None:
    """Refuse what is no format of ours."""
    if path.suffix not in SUFFIXES:
        raise FailedError(f"{path}: a log ends in {' or '.join(SUFFIXES)}; name it so")


def reason(error: OSError) -> str:
    """Return a system error in a few words."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return "no space is left for it; free some, or use --rotate-mb with --keep"
    return (error.strerror or str(error)).lower()


class WholeFile:
    """A file that only ever ends behind something whole.

    What could not be written to its end (disk full) is cut off again, so that a reader never meets
    half a record, unless the process was killed in the middle of a write.
    """

    def __init__(self, path: Path) -> None:
        self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o640)
        self.size = 0

    def append(self, data: bytes) -> None:
        """Write all of `data` or, with an OSError, none of it."""
        view, done = memoryview(data), 0
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
