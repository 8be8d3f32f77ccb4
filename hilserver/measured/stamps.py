"""The time of a foreign table: in one column or two, with the unit that the file itself says."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from hilserver.errors import LogError
from hilserver.logs.csv_times import kind_of
from hilserver.logs.table import Table
from hilserver.measured.mapping import DATED, PER_SECOND, TimeMap

_WHOLE: Final = {"sec", "secs", "s", "second", "seconds"}
_PARTS: Final = {
    "nanosec": "ns",
    "nanosecs": "ns",
    "nanoseconds": "ns",
    "nsec": "ns",
    "nsecs": "ns",
    "usec": "us",
    "usecs": "us",
    "microsec": "us",
    "microseconds": "us",
    "msec": "ms",
    "milliseconds": "ms",
}
_LAST: Final = re.compile(r"(.*?)([A-Za-z]+)\W*")
_TIME_UNITS: Final = {
    "s": "s",
    "sec": "s",
    "secs": "s",
    "seconds": "s",
    "ms": "ms",
    "msec": "ms",
    "msecs": "ms",
    "millis": "ms",
    "milliseconds": "ms",
    "us": "us",
    "usec": "us",
    "µs": "us",
    "micros": "us",
    "microseconds": "us",
    "ns": "ns",
    "nsec": "ns",
    "nsecs": "ns",
    "nanos": "ns",
    "nanoseconds": "ns",
}
DIGITS: Final = {19: "ns", 16: "us", 13: "ms", 10: "s"}
"""Of whole numbers that count from 1970."""
LONGEST_DAY: Final = len("25-Nov-2026")
_MOST_REPEATED: Final = 0.5  # share of the rows; with more, the stamps are too coarse


@dataclass(frozen=True, slots=True)
class TimeColumns:
    """Which columns hold the time."""

    time: str
    rest: str | None = None
    is_found: bool = False  # whether the second one was found, not named


def columns_of(
    time: str, rest: str | None, header: Sequence[str], first: Sequence[str] = ()
) -> TimeColumns:
    """Return the columns of a time; a second one is found where the first is only half of it.

    Parameters
    ----------
    first : sequence of str
        The first row, if the file is text.
    """
    if rest is not None or time not in header:
        return TimeColumns(time, rest)
    stem, last = _split(time)
    if last in _WHOLE:
        for name in header:
            of_other, part = _split(name)
            if of_other == stem and part in _PARTS:
                return TimeColumns(time, name, is_found=True)
    texts = dict(zip(header, first, strict=False))
    text = texts.get(time, "")
    if kind_of(text) == "date" and len(text) <= LONGEST_DAY:
        clocks = [name for name in header if kind_of(texts.get(name, "")) == "clock"]
        if clocks:
            return TimeColumns(time, clocks[0], is_found=True)
    return TimeColumns(time)


def _split(name: str) -> tuple[str, str]:
    """Return a name without its last word, and this word in lower case."""
    match = _LAST.fullmatch(name)
    return (name, "") if match is None else (match[1], match[2].lower())


def unit_in_words(name: str) -> str | None:
    """Return the unit of time at the end of a name: ``stamp_ms``, ``Time [us]``, ``secs``."""
    words = re.findall(r"[A-Za-zµ]+", name)
    return (
        _TIME_UNITS.get(words[-1].lower()) if len(words) > 1 or len(name) > 2 else None
    )


def times_of(table: Table, columns: TimeColumns, said: TimeMap) -> tuple[Table, float]:
    """Return the table with its whole time in one column, and the seconds of its unit.

    The type of a column, and dates, are always right; numbers have the unit of the mapping, else
    what the row of units or the name says. LogError if the mapping says dates and there are none.
    """
    time = columns.time
    where = f"{table.path}: column '{time}'"
    by_type = table.units.get(time) if table.stamps != "numbers" else None
    if said.unit == DATED and by_type is None and len(table.lines):
        raise LogError(
            f"{table.where(0, time)}: {table.shown(0, time)} is not a date with a time; write one,"
            " as 2026-11-25T12:00:00.020, or give the unit of the numbers"
        )
    in_file = _TIME_UNITS.get(table.units.get(time, "").lower())
    unit = by_type or said.unit or in_file or unit_in_words(time)
    notices = list(table.notices)
    if by_type is not None and said.unit not in (None, DATED, by_type):
        notices.append(
            f"{where} says its unit itself, {by_type}; the mapping's {said.unit} is not used"
        )
    is_found = by_type is None and said.unit is None
    if is_found and unit not in (None, "s"):
        notices.append(f"{where} is read in {unit}, as the file says")
    per_second = PER_SECOND[unit or "s"]
    table = replace(table, notices=notices)
    is_whole = table.stamps == "texts"
    if columns.rest is None or is_whole:
        return table, per_second
    return _with_rest(table, columns, said, per_second), per_second


def _with_rest(
    table: Table, columns: TimeColumns, said: TimeMap, per_second: float
) -> Table:
    """Return the table with a second column added to its time."""
    rest = str(columns.rest)
    in_row = _TIME_UNITS.get(table.units.get(rest, "").lower())
    unit = said.rest_unit or in_row or _PARTS.get(_split(rest)[1], "ns")
    numbers = table.matrix.copy()
    place = table.names.index(columns.time)
    # From the first one on, so that a double holds the sum to the nanosecond.
    whole = table.column(columns.time)
    since = whole - whole[:1]
    part = table.column(rest)
    numbers[:, place] = since + part * (PER_SECOND[unit] / per_second)
    notices = list(table.notices)
    if columns.is_found:
        notices.append(
            f"{table.path}: column '{rest}' [{unit}] was added to the time in '{columns.time}'"
        )
    return replace(
        table, numbers=numbers.reshape(-1), notices=notices, stamps="numbers"
    )


def refuse_coarse(path: Path, time: str, rows: int, table: Table) -> None:
    """Refuse a time of which most rows repeat a stamp: half of it stands elsewhere."""
    if table.repeated > _MOST_REPEATED * rows:
        share = 100.0 * table.repeated / rows
        raise LogError(
            f"{path}: column '{time}': {share:.0f} % of the rows repeat a time stamp; if a second"
            " column holds the rest of the time, name it, as time: {rest: nanosec}, else give the"
            " rate of the rows, as time: {rate_hz: 50}"
        )
