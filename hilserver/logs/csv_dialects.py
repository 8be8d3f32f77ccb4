"""How others write CSV: column separators, decimal marks, dates.

If commas separate columns, numbers have a point. If semicolons or tabs do, as in what programs in
half of Europe export, they may have a comma: one kind of mark in the whole file.
"""

import re
from collections.abc import Container, Iterable, Iterator
from pathlib import Path
from typing import Any, Final

from hilserver.errors import LogError
from hilserver.logs.csv_times import COMMA, stamp_ns
from hilserver.logs.table import Table, place_of

OTHERS: Final = (";", "\t")
_NAMES: Final = {";": "semicolons", "\t": "tabs", " ": "spaces"}
_QUOTED: Final = re.compile(r'"[^"]*"')


def separator_of(head: str) -> str:
    """Return what separates the columns of a file with this first row; a comma takes precedence."""
    bare = _QUOTED.sub("", head)
    found = (mark for mark in OTHERS if mark in bare and COMMA not in bare)
    return next(found, COMMA)


def decimal_notice(path: Path, separator: str) -> str:
    """Return the notice about a file whose numbers were read with decimal commas."""
    named = _NAMES.get(separator, repr(separator))
    return f"{path}: {named} separate its columns: commas are read as decimal marks"


def with_points(
    table: Table,
    reader: Any,
    rows: Iterable[list[str]],
    separator: str,
    dates: Container[str] = (),
) -> Iterator[list[str]]:
    """Yield the rows of a file not separated by commas; numbers that are read get points.

    `dates`: columns without numbers. LogError if the file has both marks.
    """
    used = ""
    places = [place for place in table.read if table.header[place] not in dates]
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
    table: Table,
    reader: Any,
    rows: Iterable[list[str]],
    time: str,
    rest: str | None = None,
) -> Iterator[list[str]]:
    """Yield the rows with nanoseconds instead of the texts in column `time`.

    `rest`: a column of times of day beside dates. LogError if there is something else.
    """
    place = table.header.index(time)
    is_split = rest is not None and rest in table.header
    second = table.header.index(str(rest)) if is_split else place
    for row in rows:
        text = row[place].strip() if place < len(row) else ""
        if text:
            whole = text
            if is_split and second < len(row):
                whole = f"{text} {row[second].strip()}"
                row[second] = ""
            ns = stamp_ns(whole)
            if ns is None:
                where = place_of(table.path, reader.line_num, table.header, time)
                raise LogError(
                    f"{where}: {text!r:.60} is not a date with a time; write one, as"
                    " 2026-11-25T12:00:00.020"
                )
            row[place] = str(ns)
        yield row
