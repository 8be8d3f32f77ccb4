"""CSV according to the log contract, and a file next to it with what CSV has no room for.

``run.csv`` has a header row, ``t_s``, ``segment`` and the signals; every number is written so that
reading it gives the same bits; ``nan`` where a status code is bad. ``run.csv.meta.json`` gives the
origin of the log and holds the states to replay from. If parameters changed,
``run.csv.parameters.jsonl`` holds their new values.
"""

import contextlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hilserver.logs import changes as sparse
from hilserver.logs.log import RecordedState
from hilserver.logs.provenance import pack_meta
from hilserver.logs.writer import Segmented, WholeFile
from hilserver.program.whole_file import whole
from hilserver.status import BAD


def meta_path(path: Path) -> Path:
    """Return the path of the file next to a CSV log."""
    return path.with_name(f"{path.name}.meta.json")


def changes_path(path: Path) -> Path:
    """Return the path of the parameter changes next to a CSV log: one line of JSON each."""
    return path.with_name(f"{path.name}.parameters.jsonl")


class CsvWriter:
    """Writes one CSV log; see `LogWriter`."""

    def __init__(
        self, path: Path, run: Mapping[str, Any], slots: Sequence[int]
    ) -> None:
        self._path, self._run, self._slots = (
            path,
            dict(run),
            np.asarray(slots, dtype=np.intp),
        )
        self._period_s = int(run["base_period_ns"]) * 1e-9
        self._states: list[RecordedState] = []
        self._file = WholeFile(path)  # before the files next to it: it may be in use
        self._write_meta()
        changes_path(path).unlink(missing_ok=True)
        names = [run["signals"][slot]["name"] for slot in slots]
        self._file.append((",".join(["t_s", "segment", *names]) + "\n").encode())

    @property
    def n_bytes(self) -> int:
        """Size of the file so far."""
        return self._file.size

    def write(self, batch: Segmented) -> None:
        """Append a row for each frame."""
        frames = batch.frames
        values = frames.values[:, self._slots]
        values[(frames.status[:, self._slots] & BAD) != 0] = np.nan
        times = (frames.ticks * self._period_s).tolist()
        rows = zip(times, batch.segments.tolist(), values.tolist(), strict=True)
        lines = [
            f"{t!r},{segment},{','.join(map(repr, row))}\n" for t, segment, row in rows
        ]
        self._file.append("".join(lines).encode())
        if batch.changes:
            with changes_path(self._path).open("a", encoding="utf-8") as file:
                file.writelines(
                    f"{sparse.as_text(change)}\n" for change in batch.changes
                )
            self._make_as_open(changes_path(self._path))

    def add_state(self, state: RecordedState) -> None:
        """Append a state to replay from."""
        self._states.append(state)
        self._write_meta()

    def tell(self, run: Mapping[str, Any]) -> None:
        """Replace what the file says about its run."""
        self._run = dict(run)
        self._write_meta()

    def _write_meta(self) -> None:
        with whole(meta_path(self._path)) as partial:
            partial.write_text(pack_meta(self._run, self._states), encoding="utf-8")
        self._make_as_open(meta_path(self._path))

    def _make_as_open(self, beside: Path) -> None:
        """Let those read a file next to the log who can read the log, and nobody else."""
        with contextlib.suppress(OSError):
            beside.chmod(self._path.stat().st_mode & 0o777)

    def flush(self) -> None:
        """Nothing is buffered."""

    def sync(self) -> None:
        """Hand everything to the disk."""
        self._file.sync()

    def close(self) -> None:
        """Close the file."""
        self._file.close()
