"""The writer of a recording, chosen by its suffix."""

import contextlib
import shutil
from collections.abc import Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from hilserver.errors import FailedError, UsageError, reason
from hilserver.logs.bag_writer import BagWriter, Storage
from hilserver.logs.csv_writer import CsvWriter, changes_path, meta_path
from hilserver.logs.log import Log
from hilserver.logs.mcap_writer import McapWriter
from hilserver.logs.rewriting import rewrite, run_of, write_table_csv
from hilserver.logs.writer import LogWriter

SUFFIXES = (".mcap", ".csv")


def open_writer(
    path: Path,
    run: Mapping[str, Any],
    slots: Sequence[int],
    utc_minus_monotonic_ns: int = 0,
    bag: Storage | None = None,
) -> LogWriter:
    """Begin a log; the suffix chooses the format. If it fails, no file is left.

    Parameters
    ----------
    run : mapping
        See `provenance.make_run`.
    slots : sequence of int
        Slots of the signals to write, rising.
    utc_minus_monotonic_ns : int
        Turns the frames' planned starts into UTC.
    bag : {"mcap", "sqlite3"}, optional
        Write a ROS 2 bag, a folder of this name, with this storage.
    """
    if bag is None:
        check_suffix(path)
    is_new = False
    try:
        is_new = not path.exists()
        if bag is not None:
            return BagWriter(path, run, slots, utc_minus_monotonic_ns, bag)
        if path.suffix == ".csv":
            return CsvWriter(path, run, slots)
        return McapWriter(path, run, slots, utc_minus_monotonic_ns)
    except OSError as error:
        if is_new:
            forget(path)
        raise FailedError(f"{path}: cannot be written: {reason(error)}") from None


def write_log(log: Log, path: Path, bag: Storage | None = None) -> None:
    """Write all of a log; a foreign one becomes a plain table as CSV."""
    if path.suffix == ".csv" and bag is None and not log.is_ours:
        write_table_csv(log, path)
        return
    described = run_of(log)
    with closing(
        open_writer(path, described, range(len(described["signals"])), 0, bag)
    ) as writer:
        rewrite(log, writer)


def forget(path: Path) -> None:
    """Remove the files of a log."""
    shutil.rmtree(path, ignore_errors=True)
    for file in (path, meta_path(path), changes_path(path)):
        with contextlib.suppress(OSError):
            file.unlink()


def check_suffix(path: Path) -> None:
    """Refuse a suffix that is not one of our formats."""
    if path.suffix not in SUFFIXES:
        raise UsageError(
            f"{path}: the name of a log must end in {' or '.join(SUFFIXES)}"
        )
