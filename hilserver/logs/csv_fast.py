"""Clean CSV parsed in C; anything else is left to the strict reader, which explains why."""

import warnings
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hilserver.logs.csv_dialects import separator_of
from hilserver.logs.csv_layout import CsvLayout
from hilserver.logs.csv_times import COMMA

_NEWLINE, _COMMA = 10, 44
_SEPARATORS = (COMMA, ";", "\t")
_LONGEST_LINE = 10_000
_PIECE = 1 << 24
_CLEAN = b"0123456789+-.eE,\nnaNifIF"


def parse_clean(
    data: bytes, layout: CsvLayout | None = None
) -> tuple[list[str], NDArray[np.float64], str] | None:
    """Return header and numbers of a CSV file, or None if only the strict reader can judge it.

    The numbers, shape (n_rows, n_columns), are bit for bit what `float` gives; empty fields are
    NaN. Row i is line `data_row` + i of the file. The last item is the column separator, if
    numbers have decimal commas. Without a layout the header is the first line.
    """
    layout = layout or _of_first_line(data)
    if layout is None or layout.separator not in _SEPARATORS:
        return None
    separator, header = layout.separator, layout.header
    begin = 0
    for _ in range(layout.data_row - 1):
        begin = data.find(b"\n", begin) + 1
        if not begin:
            return None
    if not data.endswith(b"\n"):
        return None
    has_comma, has_point = (data.find(mark, begin) >= 0 for mark in (b",", b"."))
    decimal = separator if separator != COMMA and has_comma else ""
    if decimal and has_point:
        return None
    found: list[NDArray[np.float64]] = []
    for piece in _pieces(data, begin):
        body = piece.replace(b"\r\n", b"\n")
        if separator != COMMA:
            body = body.translate(bytes.maketrans(f",{separator}".encode(), b".,"))
        if body.translate(None, _CLEAN) or not _is_regular(body, len(header)):
            return None
        numbers = _numbers(body)
        if numbers is None or len(numbers) % len(header):
            return None
        found.append(numbers)
    if not found:
        return None
    return header, np.concatenate(found).reshape(-1, len(header)), decimal


def _of_first_line(data: bytes) -> CsvLayout | None:
    """Return the layout of a table whose header is the first line; None if it has quotes."""
    head = data[: data.find(b"\n") + 1].rstrip(b"\r\n")
    if not head or b'"' in head:
        return None
    try:
        first = head.decode("utf-8-sig")
    except UnicodeDecodeError:
        return None
    separator = separator_of(first)
    return CsvLayout(separator, first.split(separator))


def _pieces(data: bytes, begin: int) -> Iterator[bytes]:
    """Yield whole lines, a limited amount at a time, to keep the parser's own memory small."""
    while begin < len(data):
        end = (
            data.rfind(b"\n", begin, begin + _PIECE) + 1 or data.find(b"\n", begin) + 1
        )
        yield data[begin:end]
        begin = end


def _is_regular(body: bytes, n_columns: int) -> bool:
    """Return whether every line has as many commas as the header."""
    codes = np.frombuffer(body, dtype=np.uint8)
    ends = np.flatnonzero(codes == _NEWLINE)
    if np.diff(ends, prepend=-1).max(initial=0) > _LONGEST_LINE:
        return False
    commas = np.searchsorted(np.flatnonzero(codes == _COMMA), ends)
    return bool((np.diff(commas, prepend=0) == n_columns - 1).all())


def _numbers(body: bytes) -> NDArray[np.float64] | None:
    for _ in range(
        2
    ):  # with three commas in a row, one pass fills only every other gap
        body = body.replace(b",,", b",nan,")
    text = body.replace(b",\n", b",nan\n").replace(b"\n", b",").decode("ascii")
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)
        try:
            return np.fromstring(text, sep=",")
        except (DeprecationWarning, ValueError):
            return None
