"""Where the table of a CSV file is: what separates its columns, its header, its row of units.

Programs write lines before the header (LabVIEW, TwinCAT Scope, comments) and lines between header
and numbers (units, types). The numbers show where the table is: they fill the same columns from
their first row on. The header is the nearest row above them that names their columns.
"""

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Final

from hilserver.errors import LogError
from hilserver.logs.csv_dialects import OTHERS, separator_of
from hilserver.logs.csv_times import COMMA, Kind, kind_of

HEAD_ROWS: Final = 200  # the numbers begin within these
HEAD_CHARACTERS: Final = 1 << 16  # of a row that is looked at
NUMBER, TEXT, NOTHING = "n", "t", "_"
_SCOPE_NAME: Final = "Name"
_SCOPE_UNITS: Final = "Unit"
_FOR_EXCEL: Final = "sep="
_COMMENT: Final = "#"
_LABVIEW_REMARK: Final = "Comment"
_UNIT: Final = re.compile(
    r"[\[(<{]?\s*(1|-|%|[umnk]?s(ec)?(onds?)?|min|h|m|[cmk]m|inch|rad|deg|°|rev|rpm|1/min|"
    r"u/min|hz|[mk]?(m|rad|deg|°|rev)\s?/\s?s(²|\^?2)?|km/h|rad\s?s\^?-1|m\s?s\^?-[12]|g|"
    r"[mk]?[vaw]|[mk]?nm?|[°º]?c|degc|bool(ean)?|counts?|ticks?|steps?|none)?\s*[\])>}]?",
    re.IGNORECASE,
)
_TYPE: Final = re.compile(
    r"l?real\d*|u?[lsdi]?int\d*|(u)?int(8|16|32|64)|float(32|64)?|double|single|bool|bit|string|"
    r"datetime|duration",
    re.IGNORECASE,
)


@dataclass(frozen=True, slots=True)
class CsvLayout:
    """The table of a file; rows are counted from 1."""

    separator: str
    header: list[str]
    header_row: int = 1
    data_row: int = 2
    # text of the row of units, by column; empty without one
    units: tuple[str, ...] = ()
    first: tuple[str, ...] = ()  # texts of the first row of numbers

    def notices(self, path: Path) -> list[str]:
        """Return what was skipped on the way to the numbers."""
        found = []
        if self.header_row > 1:
            found.append(
                f"{path}: row {self.header_row} is its header; what stands before it was skipped"
            )
        if any(self.units):
            found.append(f"{path}: a row of units was found and is used")
        elif self.data_row > self.header_row + 1:
            found.append(
                f"{path}: its numbers begin in row {self.data_row}; what stands between them and"
                " the header was skipped"
            )
        return found

    def unit(self, name: str) -> str:
        """Return the text in the row of units below a name; empty without one."""
        return dict(zip(self.header, self.units, strict=False)).get(name, "")

    def kind(self, name: str | None) -> Kind:
        """Return what the first row of numbers holds below a name."""
        place = self.header.index(name) if name in self.header else len(self.first)
        return (
            kind_of(self.first[place], self.separator)
            if place < len(self.first)
            else ""
        )


def read_layout(path: Path) -> CsvLayout | None:
    """Return the layout of a file; None if its first rows are not UTF-8 or not there."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            rows = iter(lambda: file.readline(HEAD_CHARACTERS), "")
            lines = list(islice(rows, HEAD_ROWS))
    except UnicodeDecodeError:
        return None
    return layout_of(path, lines) if lines else None


def layout_of(path: Path, lines: Sequence[str]) -> CsvLayout:
    """Return the layout of a file with these first lines."""
    separator = _separator(lines)
    rows = [_cells(line, separator) for line in lines]
    shapes = [_shape(row, separator) for row in rows]
    plain = CsvLayout(separator, rows[0], first=tuple(*rows[1:2]))
    if len(rows) < 2:
        return plain

    # The last line may be torn, so the one before it shows which columns hold numbers.
    inner = [shape for shape in shapes[1:-1] if shape.strip("_")]
    last = inner[-1] if inner else shapes[-1]
    if NUMBER not in last:
        return plain
    is_second = len(rows[0]) == len(rows[1]) and _goes_on(shapes[1], last)
    if is_second and not _is_remark(lines[0]):
        return plain

    begin = len(rows) - 1 - bool(inner)
    while begin > 0 and _goes_on(shapes[begin - 1], last):
        begin -= 1
    width = len(rows[begin])
    keys = {row[0] for row in rows[:begin] if row and len(row) == width}
    if {_SCOPE_NAME, "Data-Type"} <= keys:
        # An export of TwinCAT Scope: each of its rows begins with a key. Either one column of
        # time [ms] stands before all channels, or one before each.
        n_columns = len(rows[begin])
        at = {row[0]: i for i, row in enumerate(rows[:begin]) if len(row) == n_columns}
        names = list(rows[at[_SCOPE_NAME]])
        units = list(rows[at[_SCOPE_UNITS]]) if _SCOPE_UNITS in at else [""] * n_columns
        units = ["" if unit.lower() == "(none)" else unit for unit in units]
        whole = [row for row in rows[begin:-1] if len(row) == n_columns]
        for place in range(1, n_columns):
            if names[place] != _SCOPE_NAME:
                continue
            if any(row[place] != row[0] for row in whole):
                raise LogError(
                    f"{path}: column {place + 1} holds times of its own, other than those of column"
                    " 1; export it with one time column for all channels"
                )
            names[place] = units[place] = ""
        names[0] = "time"
        units[0] = "ms"
        header_row = at[_SCOPE_NAME] + 1
        first = tuple(rows[begin])
        return CsvLayout(separator, names, header_row, begin + 1, tuple(units), first)
    return _above(lines, rows, shapes, begin, separator) or plain


def _is_remark(line: str) -> bool:
    return line.lower().startswith((_COMMENT, _FOR_EXCEL))


def _separator(lines: Sequence[str]) -> str:
    """Return what separates the columns: what the first row says, else what the later ones show."""
    first = lines[0]
    if first.lower().startswith(_FOR_EXCEL):
        return first.rstrip("\r\n")[len(_FOR_EXCEL) :][:1] or COMMA
    mark = separator_of(first)
    inside = [line for line in lines[1:-1] if line.strip()][-3:] or list(lines[-1:])
    if not _is_remark(first) and all(mark in line for line in (first, *inside)):
        return mark

    # Decimal commas are everywhere, too, so what else comes equally often in each row is first.
    for other in (*OTHERS, COMMA):
        counts = {line.count(other) for line in inside}
        if len(counts) == 1 and 0 not in counts:
            return other
    # As trajectories of the TUM and KITTI formats are written.
    words = [line.split() for line in inside]
    is_spaced = all(len(row) > 1 and all(map(kind_of, row)) for row in words)
    return " " if is_spaced else mark


def _cells(line: str, separator: str) -> list[str]:
    if separator == " ":
        line = (
            line.strip()
        )  # of trajectories, whose writers often end rows with a space
    try:
        (row,) = csv.reader(
            [line], delimiter=separator, skipinitialspace=separator == " "
        )
    except (csv.Error, ValueError):
        row = line.split(separator)
    return [text.strip() for text in row]


def _shape(row: Sequence[str], separator: str) -> str:
    """Return a letter for each cell of a row: a number (or time), a text, or nothing."""
    letters = []
    for text in row:
        of_text = NUMBER if kind_of(text, separator) else TEXT
        letters.append(of_text if text else NOTHING)
    return "".join(letters)


def _goes_on(shape: str, last: str) -> bool:
    """Return whether a row belongs to the numbers whose last row is given."""
    below = [
        mine for mine, theirs in zip(shape, last, strict=False) if theirs == NUMBER
    ]
    return len(shape) >= len(last) and NUMBER in below and TEXT not in below


def _above(
    lines: Sequence[str],
    rows: list[list[str]],
    shapes: list[str],
    begin: int,
    separator: str,
) -> CsvLayout | None:
    """Return the layout of a table whose numbers begin in row `begin`, counted from 0."""
    width = len(rows[begin])
    above: list[tuple[int, list[str]]] = []  # rows of texts, upwards
    for at in range(begin - 1, -1, -1):
        row = rows[at]
        is_comment = lines[at].startswith(_COMMENT)
        if is_comment:
            row = _cells(lines[at].lstrip(f"{_COMMENT} "), separator)
        if row[width:] == [_LABVIEW_REMARK]:
            row = row[:width]
        is_other = len(row) != width or not any(row)
        if above and (is_other or is_comment):
            break
        if is_other:
            continue

        # A row of numbers with something broken in it, which the reader will name.
        named = [text for text in row if text]
        is_broken = 2 * shapes[at].count(NUMBER) >= len(named)
        alike = shapes[begin].replace(NOTHING, f"[{NUMBER}{NOTHING}]")
        is_inside = any(re.fullmatch(alike, shape) for shape in shapes[:at])
        if above and (is_broken or NUMBER in shapes[at]):
            break
        if is_broken or is_inside:
            begin = at
        else:
            above.append((at, row))
    if not above:
        return None

    # The highest row names the columns; below it stand units, types and the like.
    at, header = next((found for found in reversed(above) if all(found[1])), above[-1])
    units: list[str] = []
    for lower, row in reversed(above):
        named = [text for text in row if text]
        is_types = all(map(_TYPE.fullmatch, named))
        if lower > at and not is_types and any(map(_UNIT.fullmatch, named)):
            units = [text.strip("[](){}<> ") for text in row]
            break
    first = tuple(rows[begin])
    return CsvLayout(separator, header, at + 1, begin + 1, tuple(units), first)
