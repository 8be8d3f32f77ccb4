"""What stands in a column of times: numbers, dates, times of day, numbers with their unit."""

import contextlib
import re
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Final, Literal

COMMA: Final = ","
Kind = Literal["", "number", "unit", "clock", "date"]
"""Empty: none of them."""
TEXTS: Final = ("unit", "clock", "date")
"""Kinds that become nanoseconds."""

_BEGIN: Final = datetime(1970, 1, 1, tzinfo=UTC)
LARGEST_NS: Final = 2.0**63
_UNIT_NS: Final = {
    "ns": 1,
    "us": 1_000,
    "µs": 1_000,
    "ms": 1_000_000,
    "s": 1_000_000_000,
    "sec": 1_000_000_000,
    "min": 60_000_000_000,
    "h": 3_600_000_000_000,
    "hr": 3_600_000_000_000,
}
_WITH_UNIT: Final = re.compile(
    rf"([-+]?\d+(?:\.\d*)?(?:e[-+]?\d+)?)\s*({'|'.join(_UNIT_NS)})", re.IGNORECASE
)
_CLOCK: Final = re.compile(r"(?:(\d+) days? )?(\d{1,3}):(\d\d)(?::(\d\d(?:\.\d*)?))?")
# MATLAB, German and American programs; the fraction of a second is read apart
_DAYS: Final = ("%d-%b-%Y", "%d.%m.%Y", "%Y/%m/%d", "%m/%d/%Y", "%d/%m/%Y")
_DATES: Final = (
    *(f"{day} %H:%M:%S" for day in _DAYS),
    "%m/%d/%Y %I:%M:%S %p",
    *_DAYS,
)
_FRACTION: Final = re.compile(r"(?<=:\d\d)[.,](\d+)")


def kind_of(text: str, separator: str = COMMA) -> Kind:
    """Return what a text is; a decimal comma is one where commas do not separate columns."""
    text = text.strip()
    if not text:
        return ""
    point = text if separator == COMMA else text.replace(COMMA, ".", 1)
    try:
        float(point)
    except ValueError:
        pass
    else:
        return "number"
    for kind, read in _READERS:
        if read(text) is not None:
            return kind
    return ""


def stamp_ns(text: str) -> int | None:
    """Return nanoseconds of a date, a time of day or a number with its unit; None for others."""
    found = (read(text) for _, read in _READERS)
    return next((ns for ns in found if ns is not None), None)


def with_unit_ns(text: str) -> int | None:
    """Return the nanoseconds of ``0.02 sec``, as MATLAB writes durations."""
    match = _WITH_UNIT.fullmatch(text.strip().replace(COMMA, "."))
    if match is None:
        return None
    ns = float(match[1]) * _UNIT_NS[match[2].lower()]
    return round(ns) if abs(ns) < LARGEST_NS else None


def clock_ns(text: str) -> int | None:
    """Return the nanoseconds of ``12:00:00.02``, which may also be ``0 days 00:00:00.02``."""
    match = _CLOCK.fullmatch(text.strip().replace(COMMA, "."))
    if match is None:
        return None
    days, hours, minutes = (int(part or 0) for part in match.groups()[:3])
    whole = ((days * 24 + hours) * 60 + minutes) * 60 * 1_000_000_000
    return whole + round(float(match[4] or 0.0) * 1e9)


def utc_ns(text: str) -> int | None:
    """Return the nanoseconds since 1970 of a date with time, None if it is not one.

    ISO 8601, and the forms of MATLAB and of programs in Germany and America. Without a time zone
    it counts as UTC, since only differences matter. Digits beyond nanoseconds are dropped.
    """
    text = text.strip()
    if not text[:1].isdigit() or text.isdecimal():
        return None
    # datetime keeps microseconds; the rest of a fraction is added by hand
    found = _FRACTION.search(text)
    whole, fraction_ns = text, 0
    if found is not None:
        fraction_ns = int(found[1][:9].ljust(9, "0"))
        whole = text[: found.start()] + text[found.end() :]
    moment = None
    try:
        moment = datetime.fromisoformat(whole)
    except ValueError:
        for form in _DATES:
            with contextlib.suppress(ValueError):
                moment = datetime.strptime(whole, form)
                break
    if moment is None:
        return None
    aware = moment if moment.tzinfo is not None else moment.replace(tzinfo=UTC)
    return (aware - _BEGIN) // timedelta(microseconds=1) * 1000 + fraction_ns


_READERS: Final[tuple[tuple[Kind, Callable[[str], int | None]], ...]] = (
    ("unit", with_unit_ns),
    ("clock", clock_ns),
    ("date", utc_ns),
)
