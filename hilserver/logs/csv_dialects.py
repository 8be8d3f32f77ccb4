"""How others write CSV: column separators, decimal marks, dates.

If commas separate columns, numbers have a point. If semicolons or tabs do, as in what programs in
half of Europe export, they may have a comma: one kind of mark in the whole file.
"""

import re
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final

from hilserver.errors import LogError
from hilserver.logs.table import Table, place_of

COMMA: Final = ","
_OTHERS: Final = (";", "\t")
_NAMES: Final = {";": "semicolons", "\t": "tabs"}
_QUOTED: Final = re.compile(r'"[^"]*"')
_BEGIN: Final = datetime(1970, 1, 1, tzinfo=UTC)


def separator_of(head: str) -> str:
    """Return what separates the columns of a file with this first row; a comma takes precedence."""
    bare = _QUOTED.sub("", head)
    found = (mark for mark in _OTHERS if mark in bare and COMMA not in bare)
    return next(found, COMMA)


def decimal_notice(path: Path, separator: str) -> str:
    """Return the notice about a file whose numbers were read with decimal commas."""
    return f"{path}: {_NAMES[separator]} separate its columns: commas are read as decimal marks"


def with_points(
    table: Table,
    reader: Any,
    rows: Iterable[list[str]],
    separator: str,
    dates: str | None,
) -> Iterator[list[str]]:
    """Yield the rows of a file not separated by commas; numbers that are read get points.

    `dates`: a column without numbers. LogError if the file has both marks.
    """
    used, places = "", [place for place in table.read if table.header[place] != dates]
    for row in rows:
        for place in (place for place in places if place < len(row)):
            text = row[place]
            for mark, other in ((COMMA, "."), (".", COMMA)):
                if mark in text:
                    if other in text or used == other:
                        where = place_of(
                            table.path,
                            reader.line_num,
                            table.header,
                            table.header[place],
                        )
                        raise LogError(
                            f"{where}: {text!r:.60}: the file has both decimal commas and"
                            " points; use only one, and no thousands separators"
                        )
                    used = mark
            if text.count(COMMA) == 1:
                row[place] = text.replace(COMMA, ".")
        yield row
    if used == COMMA:
        table.notices.append(decimal_notice(table.path, separator))


def with_stamps(
    table: Table, reader: Any, rows: Iterable[list[str]], time: str
) -> Iterator[list[str]]:
    """Yield the rows with nanoseconds instead of the dates in column `time`.

    LogError if it contains something else.
    """
    place = table.header.index(time)
    for row in rows:
        text = row[place] if place < len(row) else ""
        if text.strip():
            ns = utc_ns(text)
            if ns is None:
                where = place_of(table.path, reader.line_num, table.header, time)
                raise LogError(
                    f"{where}: {text!r:.60} is not a date with a time; write one, as"
                    " 2026-11-25T12:00:00.020"
                )
            row[place] = str(ns)
        yield row


def utc_ns(text: str) -> int | None:
    """Return the nanoseconds since 1970 of a date with time (ISO 8601), None if it is not one.

    Without a time zone it counts as UTC, since only differences matter. Digits beyond microseconds
    are dropped.
    """
    try:
        moment = datetime.fromisoformat(text.strip().replace(COMMA, "."))
    except ValueError:
        return None
    aware = moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)
    return (aware - _BEGIN) // timedelta(microseconds=1) * 1000
