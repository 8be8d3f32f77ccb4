"""The rolling windows on disk: which files are complete."""

import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

STEM: Final = "window"
SUFFIX: Final = ".mcap"
KEPT: Final = 3  # two to compare, and the one being written
SIGNALS: Final = (
    "wheel.*.setpoint_rpm",
    "wheel.*.duty_command_pct",
    "twist.*",
    "control.mode",
    "internal.command",
    "internal.pose_request",
    "measured.*",
    "internal.samples_*",
    "internal.taken_*",
)
"""What a look needs; not `drive.enable`: the safe state of the model stops no real robot."""
_NAME: Final = re.compile(rf"{STEM}_(\d{{4,6}}){re.escape(SUFFIX)}")


@dataclass(frozen=True)
class RecalibrationWindow:
    """One window."""

    number: int
    path: Path

    @property
    def sha256(self) -> str:
        """Hash of its file; empty if it cannot be read."""
        try:
            with self.path.open("rb") as file:
                return hashlib.file_digest(file, "sha256").hexdigest()
        except OSError:
            return ""


def first_file(folder: Path) -> Path:
    """Return the name passed to the recorder, which adds numbers."""
    return folder / f"{STEM}{SUFFIX}"


def complete(folder: Path) -> Sequence[RecalibrationWindow]:
    """Return the complete windows, oldest first; the newest file is still being written."""
    return _all(folder)[:-1]


def _all(folder: Path) -> list[RecalibrationWindow]:
    try:
        names = [path for path in folder.iterdir() if _NAME.fullmatch(path.name)]
    except OSError:
        return []
    found = [
        RecalibrationWindow(int(path.stem.rpartition("_")[2]), path) for path in names
    ]
    return sorted(found, key=lambda window: window.number)


class WindowNews:
    """Reports each window once when it is complete."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        # all files found at the start were left by an earlier run
        self.last = max((one.number for one in _all(folder)), default=0)

    def next(self) -> RecalibrationWindow | None:
        """Return the newest window that has become complete; older ones are skipped."""
        found = complete(self._folder)
        if not found or found[-1].number <= self.last:
            return None
        self.last = found[-1].number
        return found[-1]
