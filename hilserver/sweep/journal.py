"""Finished machines, one line each: the file survives any end of the sweep."""

import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import IO, Any

from hilserver.errors import FailedError
from hilserver.sweep.batch import fingerprint
from hilserver.sweep.rig import MachineOutcome

NAME = "finished.jsonl"
SCHEMA = "hilserver.sweep/1"


class SweepJournal:
    """Appends outcomes to a file; with `resume`, knows those of earlier runs.

    FailedError if a file exists and is not to be continued, or belongs to another sweep.
    """

    def __init__(self, folder: Path, key: str, *, resume: bool) -> None:
        self.path = folder / NAME
        self.done: dict[int, MachineOutcome] = {}  # by index
        # fingerprints of computers other than this one, by index
        self.where: dict[int, str] = {}
        head = {"schema": SCHEMA, "key": key, "computer": fingerprint()}
        try:
            folder.mkdir(parents=True, exist_ok=True)
            end = self._read(head, resume=resume) if self.path.exists() else 0
            self._file: IO[bytes] = self.path.open("r+b" if end else "wb")
        except OSError as error:
            text = (error.strerror or "refused").lower()
            raise FailedError(f"{self.path}: cannot be written: {text}") from None
        self._file.truncate(end)  # cuts off half a line
        self._file.seek(end)
        if not end:
            self._write([head])

    def _read(self, head: dict[str, str], *, resume: bool) -> int:
        """Read what is there; return the number of bytes in whole lines."""
        content = self.path.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        if not whole:
            return 0
        if not resume:
            raise FailedError(
                f"{self.path} already exists: continue with --resume, or choose another folder"
            )
        lines = whole.splitlines()
        try:
            first = json.loads(lines[0])
            rows = [json.loads(line) for line in lines[1:]]
        except (ValueError, RecursionError):
            raise FailedError(
                f"{self.path} is damaged; choose another folder"
            ) from None
        if not isinstance(first, dict) or first.get("key") != head["key"]:
            raise FailedError(
                f"{self.path} belongs to another sweep, robot, controller or version of"
                " hilserver; choose another folder"
            )
        for row in rows:
            index = row["index"]
            self.done[index] = MachineOutcome(
                index,
                tuple(row["margins"]),
                row.get("error", ""),
                row.get("refused", ""),
            )
            if row.get("computer", first["computer"]) != fingerprint():
                self.where[index] = row.get("computer", first["computer"])
        return len(whole)

    def add(self, outcomes: Iterable[MachineOutcome], computer: str) -> None:
        """Add outcomes; they are on disk when this returns."""
        rows = []
        for outcome in outcomes:
            row: dict[str, Any] = {
                "index": outcome.index,
                "margins": list(outcome.margins),
            }
            row |= {k: v for k in ("error", "refused") if (v := getattr(outcome, k))}
            if computer != fingerprint():
                row["computer"] = self.where[outcome.index] = computer
            self.done[outcome.index] = outcome
            rows.append(row)
        self._write(rows)

    def _write(self, rows: list[dict[str, Any]]) -> None:
        self._file.write("".join(json.dumps(row) + "\n" for row in rows).encode())
        self._file.flush()

    def close(self) -> None:
        """Write everything to disk."""
        self._file.flush()
        os.fsync(self._file.fileno())
        self._file.close()
