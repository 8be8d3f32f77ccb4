"""`recalibration.jsonl`: one line per look, proposal and decision, never changed.

Each line carries the hash of the one before it, which exposes a line that was changed or removed.
Half a line, left by a daemon that was killed, is cut off at the next start.
"""

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from hilserver.errors import FailedError
from hilserver.program.whole_file import sync_folder

FILE: Final = "recalibration.jsonl"
LARGEST_BYTES: Final = 100_000_000
_FIRST: Final = "0" * 64


class History:
    """The file; a line is on disk when `append` returns.

    Raises
    ------
    FailedError
        If it cannot be read, or is not such a file.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / FILE
        self._size = 0
        self._last = _FIRST
        self.number = 0
        self.lines: list[dict[str, Any]] = []
        """Lines of earlier runs, from which their state is restored."""
        try:
            content = self.path.read_bytes() if self.path.exists() else b""
        except OSError as error:
            raise FailedError(
                f"{self.path}: {(error.strerror or str(error)).lower()}"
            ) from None
        for text in content.splitlines(keepends=True):
            line = _parsed(text)
            if line is None and self._size + len(text) < len(content):
                raise FailedError(
                    f"{self.path}: line {self.number + 1} is damaged; move the file away, or remove"
                    " the line and all that follow"
                )
            if line is None:
                break  # half a line at the end: the daemon was killed while writing it
            self.lines.append(line)
            self._size += len(text)
            self._last = str(line.get("hash", _FIRST))
            self.number += 1

    def append(self, kind: str, **fields: Any) -> dict[str, Any]:
        """Append a line, whole or not at all.

        Raises
        ------
        FailedError
            If it cannot be written, or a number in it is not finite.
        """
        now = datetime.now(UTC).isoformat(timespec="milliseconds")
        line = {"number": self.number + 1, "time": now, "kind": kind, **fields}
        line["before"] = self._last
        try:
            line["hash"] = _hash(line)
        except ValueError:
            raise FailedError(
                f"{self.path}: a {kind} contains a number that is not finite"
            ) from None
        data = (json.dumps(line, ensure_ascii=False) + "\n").encode()
        if self._size + len(data) > LARGEST_BYTES:
            raise FailedError(
                f"{self.path}: is full at {LARGEST_BYTES / 1e6:.0f} MB; move it away"
            )
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            fd = os.open(self.path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o640)
            try:
                os.ftruncate(fd, self._size)  # cuts off half a line
                os.lseek(fd, self._size, os.SEEK_SET)
                if os.write(fd, data) < len(data):
                    os.ftruncate(fd, self._size)
                    raise OSError(28, "no space is left")
                os.fsync(fd)
            finally:
                os.close(fd)
            if not self._size:
                sync_folder(self.path.parent)  # the file's name is new
        except OSError as error:
            raise FailedError(
                f"{self.path}: cannot be written: {(error.strerror or str(error)).lower()}"
            ) from None
        self._size += len(data)
        self._last = line["hash"]
        self.number += 1
        return line


def _parsed(text: bytes) -> dict[str, Any] | None:
    try:
        # `int` raises ValueError on NaN and Infinity, which `_hash` does not accept
        line = json.loads(text, parse_constant=int)
    except (ValueError, RecursionError):
        return None
    return line if text.endswith(b"\n") and isinstance(line, dict) else None


def _hash(line: Mapping[str, Any]) -> str:
    own = {key: value for key, value in line.items() if key != "hash"}
    return hashlib.sha256(
        json.dumps(own, sort_keys=True, allow_nan=False).encode()
    ).hexdigest()


def is_sound(line: Mapping[str, Any]) -> bool:
    """Return whether a line is as it was written."""
    try:
        return bool(line.get("hash") == _hash(line))
    except (ValueError, RecursionError):  # not a line of ours
        return False


def broken(lines: Iterable[Mapping[str, Any]]) -> int | None:
    """Return the number of the first line that breaks the chain; None if none does."""
    last = _FIRST
    for count, line in enumerate(lines, 1):
        if line.get("before") != last or not is_sound(line):
            return count
        last = str(line["hash"])
    return None
