"""CSV logs, ours and others': strict about what would mislead, lenient about a torn last line."""

import csv
import json
import math
import zlib
from array import array
from collections.abc import Container, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO, cast

import numpy as np
from numpy.typing import NDArray

from hilserver.errors import LogError, meant
from hilserver.logs.csv_fast import parse_clean
from hilserver.logs.csv_writer import meta_path, unpack_state
from hilserver.logs.log import Log, State
from hilserver.logs.provenance import SCHEMA

TIME, SEGMENT, BLOCK = "t_s", "segment", "block"
MAX_FIELD_CHARACTERS = 10_000


def read_csv(path: Path, known: Container[str] | None = None) -> Log:
    """Read a CSV log; see `reading.read_log`."""
    run, states = _read_meta(path)
    names = None if known is None and run is None else _Names(known, run)
    table = read_table(path, names, ours=run is not None)
    t_s = table.column(TIME)
    segment = table.integers(SEGMENT)
    if segment is None:
        segment = np.zeros(len(t_s), dtype=np.int64)
    check_time(table, TIME, segment)
    return Log(
        path=path,
        t_s=t_s,
        segment=segment,
        block=table.integers(BLOCK),
        columns={n: table.column(n) for n in table.header if n not in (TIME, SEGMENT, BLOCK)},
        run=run,
        states=states,
        notices=table.notices,
    )


@dataclass
class Table:
    """Numbers as they stand in the file.

    Attributes
    ----------
    header : list of str
        Names of the columns.
    numbers : buffer of float64
        Row after row.
    lines : sequence of int
        Line of each row in the file.
    """

    path: Path
    header: list[str]
    numbers: "array[float] | NDArray[np.float64]" = field(default_factory=lambda: array("d"))
    lines: "array[int] | range" = field(default_factory=lambda: array("q"))
    notices: list[str] = field(default_factory=list)

    def column(self, name: str) -> NDArray[np.float64]:
        """Return a column, shape (n_rows,)."""
        table = np.frombuffer(self.numbers).reshape(-1, len(self.header))
        return np.ascontiguousarray(table[:, self.header.index(name)])

    def where(self, row: int, name: str) -> str:
        """Return the place of a number in words."""
        return _where(self.path, self.lines[row], self.header, name)

    def integers(self, name: str) -> NDArray[np.int64] | None:
        """Return a column of whole numbers, shape (n_rows,); None if there is none."""
        if name not in self.header:
            return None
        numbers = self.column(name)
        wrong = np.flatnonzero(~(np.isfinite(numbers) & (numbers == np.rint(numbers))))
        if wrong.size:
            where = self.where(int(wrong[0]), name)
            raise LogError(f"{where}: {float(numbers[wrong[0]])!r} is no whole number; write one")
        return numbers.astype(np.int64)


class _Names:
    """Which columns a log may have."""

    def __init__(self, known: Container[str] | None, run: Mapping[str, Any] | None) -> None:
        own = [] if run is None else [s["name"] for s in run["signals"]]
        self._known, self._own = known, own
        iterable = known if isinstance(known, Sequence | set | frozenset | dict) else ()
        self._all = [*own, *iterable, TIME, SEGMENT, BLOCK]

    def __contains__(self, name: str) -> bool:
        return name in self._all or (self._known is not None and name in self._known)

    def hint(self, name: str) -> str:
        return meant(name, self._all, "see 'hilserver signals' for the names")


def _where(path: Path, line: int, header: Sequence[str], name: str) -> str:
    return f"{path}: row {line}, column {header.index(name) + 1} '{name:.60}'"


def read_table(
    path: Path, names: "_Names | None" = None, *, ours: bool = False, time: str | None = TIME
) -> Table:
    """Read the numbers of a CSV file.

    Parameters
    ----------
    names : optional
        Which columns it may have; None: any.
    ours : bool
        A last line without an end is torn, even if it looks whole.
    time : str or None
        A column it must have.

    Raises
    ------
    LogError
        One sentence that names file, row, column and remedy.
    """
    clean = parse_clean(path.read_bytes())
    if clean is not None:
        header, numbers = clean
        header = _check_header(path, header, names, time)
        return Table(path, header, numbers.reshape(-1), range(2, len(numbers) + 2))
    csv.field_size_limit(MAX_FIELD_CHARACTERS)
    with path.open(encoding="utf-8-sig", newline="") as file:
        try:
            return _parse(path, file, names, time, drop_unended=ours)
        except UnicodeDecodeError as error:
            raise LogError(_undecodable(path, error)) from None
        except csv.Error as error:
            raise LogError(f"{path}: is not CSV: {error}; write UTF-8 text with commas") from None


def _undecodable(path: Path, error: UnicodeDecodeError) -> str:
    data = path.read_bytes()
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as again:
        error = again
    row = data.count(b"\n", 0, error.start) + 1
    return f"{path}: row {row}: byte {error.start} is not UTF-8; save the file as UTF-8"


def _parse(
    path: Path, file: TextIO, names: _Names | None, time: str | None, *, drop_unended: bool
) -> Table:
    lines = _Lines(file)
    reader = csv.reader(lines, strict=True)
    header = next(reader, None)
    table = Table(path, _check_header(path, header, names, time))
    width = len(table.header)
    held: tuple[int, list[str]] | None = None
    for row in reader:
        if held is not None:
            _append(table, *held)
        held = (reader.line_num, row) if row else None
    if held is None:
        return table
    torn = not lines.ended and (drop_unended or len(held[1]) < width)
    if torn:
        table.notices.append(f"{path}: row {held[0]}: the last line is incomplete and was dropped")
    else:
        _append(table, *held)
    return table


class _Lines:
    """Lines of a file; remembers whether the last one ended."""

    def __init__(self, file: TextIO) -> None:
        self._file = file
        self.ended = True

    def __iter__(self) -> Iterator[str]:
        for line in self._file:
            self.ended = line.endswith(("\n", "\r"))
            yield line


def _check_header(
    path: Path, header: list[str] | None, names: _Names | None, time: str | None
) -> list[str]:
    if header is None:
        raise LogError(f"{path}: is empty; the first row has to be the header 't_s,<signal>,...'")
    header = [name.strip() for name in header]
    for separator, name in ((";", "';'"), ("\t", "tabs")):
        if len(header) == 1 and separator in header[0]:
            raise LogError(
                f"{path}: row 1: columns are separated by {name}; separate them by commas"
            )
    if all(_is_number(name) for name in header):
        raise LogError(
            f"{path}: row 1 is no header but numbers; put 't_s,<signal>,...' into the first row"
        )
    if time is not None and time not in header:
        raise LogError(f"{path}: row 1: there is no column '{time}'; name the time column so, in s")
    for index, name in enumerate(header):
        where = f"{path}: row 1, column {index + 1} '{name:.60}'"
        if name in header[:index]:
            raise LogError(f"{where}: the column stands there twice; remove one of them")
        if names is not None and name not in names:
            raise LogError(f"{where}: there is no such signal; {names.hint(name)}")
    return header


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _append(table: Table, line: int, row: list[str]) -> None:
    width = len(table.header)
    if len(row) != width:
        raise LogError(
            f"{table.path}: row {line} has {len(row)} columns, the header has {width};"
            " remove or complete the row"
        )
    try:
        numbers = list(map(float, row))
    except ValueError:
        numbers = [_number(table, line, i, text) for i, text in enumerate(row)]
    cast("array[float]", table.numbers).extend(numbers)
    cast("array[int]", table.lines).append(line)


def _number(table: Table, line: int, index: int, text: str) -> float:
    if not text.strip():
        return math.nan
    try:
        return float(text)
    except ValueError:
        where = _where(table.path, line, table.header, table.header[index])
        raise LogError(
            f"{where}: {text!r:.60} is no number; write one with a decimal point, or nothing"
        ) from None


def check_time(table: Table, time: str, segment: NDArray[np.int64]) -> None:
    """Refuse missing times and times that do not rise within a segment.

    Raises
    ------
    LogError
    """
    t = table.column(time)
    missing = np.flatnonzero(~np.isfinite(t))
    if missing.size:
        where = table.where(int(missing[0]), time)
        raise LogError(f"{where}: there is no time; every row needs one, in s")
    fall = np.flatnonzero((np.diff(t) <= 0) & (np.diff(segment) == 0))
    if fall.size:
        row = int(fall[0]) + 1
        raise LogError(
            f"{table.where(row, time)}: {float(t[row])!r} does not rise after"
            f" {float(t[row - 1])!r}; sort the rows, or tell runs apart by a column 'segment'"
        )


def _read_meta(path: Path) -> tuple[dict[str, Any] | None, list[State]]:
    """Return what stands in the file beside the log; None for a log of others."""
    beside = meta_path(path)
    if not beside.exists():
        return None, []
    try:
        run: dict[str, Any] = json.loads(beside.read_text(encoding="utf-8"))
        if run["schema"] != SCHEMA:
            raise LogError(f"{beside}: is not of schema {SCHEMA}")
        states = [unpack_state(entry) for entry in run.pop("states")]
        _ = [signal["name"] for signal in run["signals"]], int(run["base_period_ns"])
    except (ValueError, KeyError, TypeError, AttributeError, OSError, zlib.error):
        raise LogError(
            f"{beside}: is damaged; remove it to read {path.name} as a log of others"
        ) from None
    return run, states
