"""The files of one recording: one, or a rotation of which the newest are kept."""

import contextlib
import math
import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hilserver.errors import FailedError, reason
from hilserver.logs import LogWriter, open_writer
from hilserver.logs.bag_writer import Storage
from hilserver.logs.csv_writer import changes_path, meta_path
from hilserver.logs.writer import size_of


@dataclass(frozen=True, slots=True)
class Settings:
    """What to record, and where to."""

    path: Path
    # patterns; inputs (hidden ones too) are needed for a replay
    signals: Sequence[str] = ("*",)
    rotate_bytes: int | None = None
    # also begin a new file after so much time of the plant
    rotate_s: float | None = None
    keep: int | None = None  # the newest files of a rotation
    # leave out frames in which no recorded signal changes, see `thinning`
    sparse: bool = False
    # the recording ends at this total size of files, or when so little disk space is left
    max_bytes: float = math.inf
    keep_free_bytes: float = 0.0
    buffer_bytes: int = 64_000_000  # see `WriteBehind`
    # True: the reader waits for a slow disk; False: frames are dropped and counted
    waits: bool = False
    # write a ROS 2 bag, a folder of this name
    bag: Storage | None = None


class FileSeries:
    """Opens one file after the other.

    Without rotation there is one file, `path`. With it the files are ``name_0001.mcap``,
    ``name_0002.mcap`` ...; numbers continue after existing files.
    """

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._opened = 0
        self._path = settings.path
        self._keep = settings.keep
        self._rotate_bytes = settings.rotate_bytes
        self._rotates = (
            settings.rotate_s is not None or settings.rotate_bytes is not None
        )
        self.current = settings.path

    def open(
        self, run: Mapping[str, Any], slots: Sequence[int], utc_minus_monotonic_ns: int
    ) -> LogWriter:
        """Begin the next file and remove the oldest ones beyond `keep`.

        FailedError if it cannot be made, or the disk is nearly full.
        """
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FailedError(
                f"{self._path}: cannot be written: {reason(error)}"
            ) from None
        if self._rotates:
            number = max(self._numbers(), default=0) + 1
            if number > 999_999:
                raise FailedError(
                    f"{self._path}: too many files with this name; choose another"
                )
            self.current = self._file(number)
        self._check_room("cannot begin")
        writer = open_writer(
            self.current, run, slots, utc_minus_monotonic_ns, self._settings.bag
        )
        self._opened += 1
        self._remove_old()
        return writer

    def check(self, writer: LogWriter) -> None:
        """End the recording at a limit.

        FailedError if it has reached its limit, or the disk is nearly full.
        """
        complete = self._opened - 1
        if self._keep is not None:
            complete = min(complete, self._keep - 1)
        if self._rotate_bytes is not None or not complete:
            n_bytes = complete * (self._rotate_bytes or 0) + writer.n_bytes
        else:
            newest = self._numbers()[-complete - 1 :]
            n_bytes = sum(size_of(self._file(n)) for n in newest)
        if n_bytes >= self._settings.max_bytes:
            raise FailedError(
                f"{self.current}: the recording has ended at {n_bytes / 1e6:.0f} MB, its limit; see"
                " recording.max_mb, --max-mb and --keep"
            )
        self._check_room("has ended")

    def _check_room(self, what: str) -> None:
        free = shutil.disk_usage(self.current.parent).free
        if free < self._settings.keep_free_bytes:
            raise FailedError(
                f"{self.current}: the recording {what}, as {free / 1e6:.0f} MB are left on the"
                " disk; remove some files, or see recording.keep_free_mb and --keep-free-mb"
            )

    def is_full(self, writer: LogWriter) -> bool:
        """Return whether it is time for the next file."""
        return self._rotate_bytes is not None and writer.n_bytes >= self._rotate_bytes

    def _file(self, number: int) -> Path:
        return self._path.with_name(
            f"{self._path.stem}_{number:04d}{self._path.suffix}"
        )

    def _numbers(self) -> list[int]:
        stem = re.escape(self._path.stem)
        suffix = re.escape(self._path.suffix)
        pattern = re.compile(rf"{stem}_(\d{{4,6}}){suffix}")
        names = (pattern.fullmatch(path.name) for path in self._path.parent.iterdir())
        return sorted(int(match[1]) for match in names if match)

    def _remove_old(self) -> None:
        if not self._rotates or self._keep is None:
            return
        for number in self._numbers()[: -self._keep]:
            file = self._file(number)
            for path in (file, meta_path(file), changes_path(file)):
                with contextlib.suppress(OSError):
                    path.unlink()
