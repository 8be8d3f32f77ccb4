"""Tables of numbers as in a file, and their rows in time: one for every stamp."""

import csv
from array import array
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from hilserver.errors import LogError

TIME, SEGMENT, BLOCK = "t_s", "segment", "block"
EXACT: Final = 1 << 53  # whole numbers from here on may not fit a double
NS_PER: Final = {"s": 1e9, "ms": 1e6, "us": 1e3, "ns": 1.0}
FEW_ROWS: Final = 10  # rows slightly out of order are sorted; more are a separate run


@dataclass
class Table:
    """Numbers as they are in the file."""

    path: Path
    header: list[str]  # names of the file's columns
    # row after row, of the columns `read`
    numbers: "array[float] | NDArray[np.float64]" = field(
        default_factory=lambda: array("d")
    )
    # line of each row in the file
    lines: "array[int] | range | NDArray[np.int64]" = field(
        default_factory=lambda: array("q")
    )
    notices: list[str] = field(default_factory=list)
    # indices in the header of the columns that were read; all if not given
    read: list[int] = field(default_factory=list)
    origin: int = 0  # what the stamps count from, if they are too long for a double
    # what the file itself says: a row of units, the type of a column; by name
    units: Mapping[str, str] = field(default_factory=dict)
    header_row: int = 1
    separator: str = ""  # of the columns, if the file is text
    # what the times are; texts stand for dates, times of day and numbers with a unit
    stamps: Literal["numbers", "texts", "moments", "durations"] = "numbers"
    repeated: int = 0  # rows of which something was dropped, as they repeat a stamp

    def __post_init__(self) -> None:
        self.read = self.read or list(range(len(self.header)))

    @property
    def names(self) -> list[str]:
        """Names of the columns that were read."""
        return [self.header[place] for place in self.read]

    @property
    def matrix(self) -> NDArray[np.float64]:
        """The numbers, shape (n_rows, n_columns)."""
        return np.frombuffer(self.numbers).reshape(-1, len(self.read))

    def column(self, name: str) -> NDArray[np.float64]:
        """Return a column, shape (n_rows,)."""
        return np.ascontiguousarray(self.matrix[:, self.names.index(name)])

    def where(self, row: int, name: str) -> str:
        """Return the place of a number in words."""
        return place_of(self.path, int(self.lines[row]), self.header, name)

    def shown(self, row: int, name: str) -> str:
        """Return a time as the file shows it."""
        number = float(self.column(name)[row])
        if self.stamps == "texts" and self.separator:
            with self.path.open(encoding="utf-8-sig", newline="") as file:
                reader = csv.reader(file, delimiter=self.separator)
                rows = (cells for cells in reader if reader.line_num == self.lines[row])
                cells = dict(zip(self.header, next(rows, []), strict=False))
                return repr(cells.get(name, "").strip())
        if self.stamps in ("moments", "durations"):
            count = self.origin + int(number)
            unit = self.units[name]
            kind = "datetime64" if self.stamps == "moments" else "timedelta64"
            return f"'{np.array(count).astype(f'{kind}[{unit}]')}'".replace("T", " ")
        return repr(number) if not self.origin else str(self.origin + int(number))

    def integers(self, name: str) -> NDArray[np.int64] | None:
        """Return a column of whole numbers, shape (n_rows,); None if there is none."""
        if name not in self.header:
            return None
        numbers = self.column(name)
        wrong = np.flatnonzero(~(np.isfinite(numbers) & (numbers == np.rint(numbers))))
        if wrong.size:
            where = self.where(int(wrong[0]), name)
            raise LogError(
                f"{where}: {float(numbers[wrong[0]])!r} is not a whole number; write one"
            )
        return numbers.astype(np.int64)

    def segment(self, name: str = SEGMENT) -> NDArray[np.int64]:
        """Return the segment of every row; 0 if the file has no such column."""
        found = self.integers(name)
        return np.zeros(len(self.lines), dtype=np.int64) if found is None else found


def place_of(path: Path, line: int, header: Sequence[str], name: str) -> str:
    """Return the place of a number in words."""
    return f"{path}: row {line}, column {header.index(name) + 1} '{name:.60}'"


def in_time(
    table: Table, time: str, segment: str = SEGMENT, block: str = BLOCK
) -> Table:
    """Return the table with one row for every stamp.

    LogError if a time is missing, or decreases within a segment.
    """
    t = table.column(time)
    run = table.segment(segment)
    missing = np.flatnonzero(~np.isfinite(t))
    if missing.size:
        where = table.where(int(missing[0]), time)
        raise LogError(f"{where}: the time is missing; every row needs one, in s")
    fall = np.flatnonzero((np.diff(t) < 0) & (np.diff(run) == 0))
    if fall.size:
        raise _falls(table, time, t, run, int(fall[0]) + 1)
    keys = [i for i, name in enumerate(table.names) if name in (time, segment, block)]
    numbers, first, repeated = first_of_equal(t, run, table.matrix, keys)
    if len(numbers) == len(t):
        return table
    notices = [*table.notices, *repeated_stamps(str(table.path), repeated, "rows")]
    lines = np.asarray(table.lines)[first]
    return replace(
        table,
        numbers=numbers.reshape(-1),
        lines=lines,
        notices=notices,
        repeated=repeated,
    )


def _falls(
    table: Table, time: str, t: NDArray[np.float64], run: NDArray[np.int64], row: int
) -> LogError:
    """Return the complaint about a time that decreases, with the remedy that helps."""
    later = np.flatnonzero(t[row:] > t[row - 1])
    rows = int(later[0]) if later.size else len(t) - row
    begins_anew = t[row] <= t[np.argmax(run == run[row])]
    is_backwards = 2 * np.count_nonzero(np.diff(t) < 0) > len(t)
    remedy = (
        "number the runs in a column 'segment'"
        if (begins_anew or rows > FEW_ROWS) and not is_backwards
        else "sort the rows by time"
    )
    if table.stamps in ("texts", "moments") and not is_backwards:
        hours = (t[row - 1] - t[row]) * NS_PER[table.units[time]] / 3.6e12
        if 0.9 < hours <= 1.0:
            remedy = (
                "local time repeats an hour at the end of summer time: number the rows from here"
                " on in a column 'segment', or write UTC"
            )
        elif 22.0 < hours <= 24.0:
            remedy = "it is past midnight: write the date, too"
    now, before = (table.shown(i, time) for i in (row, row - 1))
    return LogError(
        f"{table.where(row, time)}: {now} is not later than {before}; {remedy}"
    )


def first_of_equal(
    stamps: NDArray[np.float64] | NDArray[np.int64],
    segment: NDArray[np.int64],
    values: NDArray[np.float64],
    keys: Sequence[int] = (),
) -> tuple[NDArray[np.float64], NDArray[np.int64], int]:
    """Merge consecutive rows with one stamp: the first value of each column counts.

    Parameters
    ----------
    values : ndarray, shape (n, k)
        NaN where there is none.
    keys : sequence of int
        Columns that are not measurements.

    Returns
    -------
    values, rows, repeated
        The first row of every stamp in the one table, and how many rows held a value too many.
    """
    begins = np.ones(len(stamps), dtype=np.bool_)
    begins[1:] = (np.diff(stamps) != 0) | (np.diff(segment) != 0)
    first = np.flatnonzero(begins)
    if begins.all():
        return values, first, 0
    group = np.cumsum(begins) - 1
    merged = np.full((len(first), values.shape[1]), np.nan)
    too_many = np.zeros(len(stamps), dtype=np.bool_)
    for column in range(values.shape[1]):
        there = np.flatnonzero(~np.isnan(values[:, column]))
        again = np.diff(group[there], prepend=-1) == 0
        kept = there[~again]
        merged[group[kept], column] = values[kept, column]
        if column not in keys:
            too_many[there[again]] = True
    return merged, first, int(too_many.sum())


def repeated_stamps(where: str, repeated: int, what: str) -> list[str]:
    """Return the notice about rows or messages with repeated stamps."""
    if not repeated:
        return []
    return [
        f"{where}: {repeated} {what} with a repeated time stamp were dropped; the first of"
        " each is kept"
    ]
