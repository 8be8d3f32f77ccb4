"""CSV logs, ours and others': strict about what would mislead, lenient about a torn last line."""

import csv
import math
from array import array
from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TextIO, cast

import numpy as np

from hilserver.errors import LogError, meant
from hilserver.logs import changes as sparse
from hilserver.logs.csv_dialects import decimal_notice, with_points, with_stamps
from hilserver.logs.csv_fast import parse_clean
from hilserver.logs.csv_layout import CsvLayout, read_layout
from hilserver.logs.csv_times import COMMA, TEXTS
from hilserver.logs.csv_writer import changes_path, meta_path
from hilserver.logs.log import Change, Log, RecordedState
from hilserver.logs.provenance import unpack_meta
from hilserver.logs.table import (
    BLOCK,
    EXACT,
    NS_PER,
    SEGMENT,
    TIME,
    Table,
    in_time,
    place_of,
)

MAX_FIELD_CHARACTERS = 10_000
NO_NAME = ("#", "sep=")
"""How a comment begins, and a line that only Excel reads."""


def read_csv(path: Path, known: Container[str] | None = None) -> Log:
    """Read a CSV log; see `reading.read_log`."""
    run, states = _read_meta(path)
    names = None if known is None and run is None else _Names(known, run)
    table = in_time(read_table(path, names, ours=run is not None), TIME)
    t_s = table.column(TIME)
    if table.stamps == "texts":
        t_s = t_s * (NS_PER["ns"] / NS_PER["s"])
    return Log(
        path=path,
        t_s=t_s,
        segment=table.segment(),
        block=table.integers(BLOCK),
        columns={
            n: table.column(n) for n in table.names if n not in (TIME, SEGMENT, BLOCK)
        },
        run=run,
        states=states,
        changes=_read_changes(path),
        notices=table.notices,
    )


class _Names:
    """Which columns a log may have."""

    def __init__(
        self, known: Container[str] | None, run: Mapping[str, Any] | None
    ) -> None:
        own = [] if run is None else [s["name"] for s in run["signals"]]
        self._known = known
        self._own = own
        iterable = known if isinstance(known, Sequence | set | frozenset | dict) else ()
        self._all = [*own, *iterable, TIME, SEGMENT, BLOCK]

    def __contains__(self, name: str) -> bool:
        return name in self._all or (self._known is not None and name in self._known)

    def hint(self, name: str) -> str:
        return meant(name, self._all, "see 'hilserver signals' for the names")


def read_table(
    path: Path,
    names: "_Names | None" = None,
    *,
    ours: bool = False,
    time: str | None = TIME,
    used: Container[str] | None = None,
    rest: str | None = None,
    layout: CsvLayout | None = None,
    dated: bool = False,
) -> Table:
    """Read the numbers of a CSV file.

    LogError: one sentence that names file, row, column and remedy.

    Parameters
    ----------
    names : optional
        Which columns it may have; None for any.
    ours : bool
        Whether a last line without an end is torn, even if it looks whole.
    time : str or None
        A column that it must have. Dates, times of day and numbers with a unit become nanoseconds.
    used : container of str, optional
        Columns to read; the content of the others does not matter. None for all that have a name.
    rest : str, optional
        A column of times of day, if the dates in `time` have none.
    layout : CsvLayout, optional
        If it is known already.
    dated : bool
        Whether the times must be dates, whatever the first one looks like.
    """
    layout = layout or (None if ours else read_layout(path)) or CsvLayout(COMMA, [])
    clean = None
    texts = dated or layout.kind(time) in TEXTS
    if not texts:
        clean = parse_clean(path.read_bytes(), layout if layout.header else None)
    if clean is not None:
        header, numbers, decimal = clean
        table = _begin(path, header, names, time, used, layout)
        table.notices += [decimal_notice(path, decimal)] if decimal else []
        table.numbers = np.ascontiguousarray(numbers[:, table.read]).reshape(-1)
        table.lines = range(layout.data_row, len(numbers) + layout.data_row)
        if time is None or not np.abs(table.column(time)[:1]).max(initial=0.0) >= EXACT:
            return table
    return _read_strictly(path, layout, names, time, used, rest, ours=ours, texts=texts)


def _read_strictly(
    path: Path,
    layout: CsvLayout,
    names: "_Names | None",
    time: str | None,
    used: Container[str] | None,
    rest: str | None,
    *,
    ours: bool,
    texts: bool,
) -> Table:
    """Read row by row what the fast parser leaves; it names each mistake."""
    csv.field_size_limit(MAX_FIELD_CHARACTERS)
    with path.open(encoding="utf-8-sig", newline="") as file:
        try:
            lines = _Lines(file, layout)
            is_spaced = layout.separator == " "
            reader = csv.reader(
                lines,
                delimiter=layout.separator,
                strict=True,
                skipinitialspace=is_spaced,
            )
            raw = next((row for row in reader if row), None)
            is_first = layout.header_row == 1 and raw and not raw[0].startswith(NO_NAME)
            names_row = raw if is_first or not layout.header else layout.header
            table = _begin(path, names_row, names, time, used, layout)
            rows: Iterable[list[str]] = _without(raw, table, reader)
            if layout.separator != COMMA:
                unread = [str(time), str(rest)] if texts else ()
                rows = with_points(table, reader, rows, layout.separator, unread)
            if texts and time is not None:
                rows = with_stamps(table, reader, rows, time, rest)
                table.stamps, table.units = "texts", {**table.units, time: "ns"}
            return _parse(table, reader, rows, lines, time, drop_unended=ours)
        except UnicodeDecodeError as error:
            data, at = path.read_bytes(), error.start
            try:
                data.decode("utf-8")
            except UnicodeDecodeError as whole:
                # The place in the whole file: a reader in portions counts in its portion.
                at = whole.start
            line = data.count(b"\n", 0, at) + 1
            raise LogError(
                f"{path}: row {line}: byte {at} is not UTF-8; save the file as UTF-8"
            ) from None
        except csv.Error as error:
            raise LogError(
                f"{path}: not CSV: {error}; write UTF-8 text with commas"
            ) from None


def _without(
    header: list[str] | None, table: Table, reader: Any
) -> Iterator[list[str]]:
    """Yield the rows without repeated headers, which recorders write when they begin anew."""
    again: list[int] = []
    for row in reader:
        if row != header:
            yield row
        else:
            again.append(reader.line_num)
    if again:
        more = f" and in {len(again) - 1} more" if len(again) > 1 else ""
        table.notices.append(
            f"{table.path}: the header is repeated in row {again[0]}{more}; it was skipped there"
        )


def _parse(
    table: Table,
    reader: Any,
    rows: Iterable[list[str]],
    lines: "_Lines",
    time: str | None,
    *,
    drop_unended: bool,
) -> Table:
    width = len(table.header)
    at = -1 if time is None else table.names.index(time)
    held: tuple[int, list[str]] | None = None
    for row in rows:
        if held is not None:
            _append(table, *held, at)
        held = (reader.line_num, row) if any(map(str.strip, row)) else None
    if held is None:
        return table
    torn = not lines.ended and (drop_unended or len(held[1]) < width)
    if torn:
        table.notices.append(
            f"{table.path}: row {held[0]}: the last line is incomplete and was dropped"
        )
    else:
        _append(table, *held, at)
    return table


class _Lines:
    """Lines of a file, empty outside its table; remembers whether the last one was terminated."""

    def __init__(self, file: TextIO, layout: CsvLayout) -> None:
        self._file = file
        self._layout = layout
        self.ended = True

    def __iter__(self) -> Iterator[str]:
        layout = self._layout
        for number, line in enumerate(self._file, 1):
            self.ended = line.endswith(("\n", "\r"))
            is_outside = number < layout.data_row and number != layout.header_row
            yield "\n" if is_outside else line


def _begin(
    path: Path,
    header: list[str] | None,
    names: _Names | None,
    time: str | None,
    used: Container[str] | None,
    layout: CsvLayout,
) -> Table:
    """Return the checked, empty table of a header."""
    if header is None:
        raise LogError(
            f"{path}: is empty; the first row must be the header 't_s,<signal>,...'"
        )
    header = [name.strip() for name in header]
    if header[:1] and header[0].startswith(NO_NAME):
        raise LogError(
            f"{path}: row 1 begins with {header[0][:4]!r}; the header must be the first row and"
            " begin with the name of a column: remove everything before it, or write the names if"
            " there are none"
        )
    if all(_is_number(name or "0") for name in header):
        raise LogError(
            f"{path}: row 1 contains numbers instead of a header; put 't_s,<signal>,...' in the"
            " first row"
        )
    row = f"{path}: row {layout.header_row}"
    if time is not None and time not in header:
        raise LogError(
            f"{row}: there is no column '{time}'; give the time column this name, in s,"
            " or map it with --mapping"
        )
    read = [
        i for i, name in enumerate(header) if name and (used is None or name in used)
    ]
    for index in read:
        name = header[index]
        if name in header[:index]:
            raise LogError(
                f"{row}, column {index + 1} '{name:.60}': the column appears twice;"
                " remove one of them"
            )
        if names is not None and name not in names:
            where = place_of(path, layout.header_row, header, name)
            raise LogError(f"{where}: there is no such signal; {names.hint(name)}")
    table = Table(path, header, read=read, notices=layout.notices(path))
    table.header_row = layout.header_row
    table.separator = layout.separator
    table.units = {name: unit for name in header if (unit := layout.unit(name))}
    return table


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _append(table: Table, line: int, row: list[str], at: int) -> None:
    """Append a row; `at` is the column of the stamps, -1 without one."""
    width = len(table.header)
    if len(row) < width or any(map(str.strip, row[width:])):
        remedy = "remove or complete the row"
        if len(row) > width:
            remedy += (
                ", or separate the columns with semicolons if decimals have commas"
            )
        raise LogError(
            f"{table.path}: row {line} has {len(row)} columns, the header has {width}; {remedy}"
        )
    try:
        numbers = [float(row[place]) for place in table.read]
    except ValueError:
        if line == 2 and not any(map(_is_number, row)):
            raise LogError(
                f"{table.path}: row 2 contains no number; remove everything between the header"
                " and the numbers, such as a row of units"
            ) from None
        numbers = [_number(table, line, place, row[place]) for place in table.read]
    if at >= 0 and (table.origin or abs(numbers[at]) >= EXACT):
        numbers[at] = _since_first(table, row[table.read[at]], numbers[at])
    cast("array[float]", table.numbers).extend(numbers)
    cast("array[int]", table.lines).append(line)


def _since_first(table: Table, text: str, value: float) -> float:
    """Return a stamp that is too long for a double as the time since the first one."""
    try:
        stamp = int(text)
    except ValueError:
        return value - table.origin
    if not table.lines:
        table.origin = stamp
    return float(stamp - table.origin)


def _number(table: Table, line: int, index: int, text: str) -> float:
    if not text.strip():
        return math.nan
    try:
        return float(text)
    except ValueError:
        where = place_of(table.path, line, table.header, table.header[index])
        raise LogError(
            f"{where}: {text!r:.60} is not a number; write one with a decimal point, or nothing"
        ) from None


def _read_meta(path: Path) -> tuple[dict[str, Any] | None, list[RecordedState]]:
    """Return the content of the file that accompanies the log; None for a foreign log."""
    meta = meta_path(path)
    if not meta.exists():
        return None, []
    try:
        return unpack_meta(meta.read_text(encoding="utf-8"))
    except (ValueError, OSError):
        raise LogError(
            f"{meta}: is damaged; remove it to read {path.name} as a foreign log"
        ) from None


def _read_changes(path: Path) -> list[Change]:
    """Return the content of the file with the parameter changes of the log."""
    beside = changes_path(path)
    if not beside.exists():
        return []
    try:
        lines = beside.read_text(encoding="utf-8").splitlines(keepends=True)
        return [sparse.from_text(line) for line in lines if line.endswith("\n")]
    except (ValueError, KeyError, TypeError, AttributeError):
        raise LogError(
            f"{beside}: is damaged; replay {path.name} without it with --as-inputs"
        ) from None
