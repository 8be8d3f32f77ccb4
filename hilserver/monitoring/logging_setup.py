"""Logging: one chain for our own lines and those of libraries.

Readable on a terminal (local time, no logger names, no ``details``), one JSON object per line
otherwise (UTC). A repeated line is printed once per window and counted; the next one printed
has the number of those left out::

    overrun  cause=preempted slice=plant ...
    overrun  cause=preempted slice=plant suppressed=1843 ...

Log messages of libraries through the standard library (asyncua, asyncio) are treated alike. An
expected error is one line; a traceback means a defect.
"""

import asyncio
import contextlib
import logging
import re
import sys
import time
from collections.abc import Callable, MutableMapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TextIO

import structlog

from hilserver.core.events import Event, EventKind
from hilserver.errors import UserError
from hilserver.program.writer import Footer, Writer

if TYPE_CHECKING:  # loading the scheduler takes longer than most commands
    from hilserver.scheduler import OverrunReport

EventDict = MutableMapping[str, Any]

KEYS_MAX = 1024
# Every change of state must show, even if a robot starts and stops often within a minute.
ALLOWED_AT_ONCE = 20
_OFTEN = {
    EventKind.STATE,
    EventKind.SAFE_STATE,
    EventKind.PEER_LOST,
    EventKind.PEER_RESTORED,
}
TEXT_LENGTH_MAX = 2000
EXPECTED_ERRORS = (UserError, OSError, TimeoutError, EOFError, asyncio.CancelledError)
# logs a traceback whenever a client disconnects in mid-answer
TRACING_LIBRARY = "asyncua"
LIBRARIES = ("asyncua", "asyncio")  # their INFO lines do not help a user of the robot
_NUMBERS = re.compile(r"0x[0-9a-fA-F]+|[-+]?\d+(?:\.\d+)?")


Stream = TextIO | Writer | Footer


@dataclass(slots=True)
class _Repeats:
    text: str
    begin_s: float
    passed: int = 1
    suppressed: int = 0


class RepeatLimiter:
    """A structlog processor that drops a line seen less than `window_s` ago, and counts it.

    Lines that differ only in numbers count as equal. Events of `_OFTEN` may come several times
    before the limit applies. At most `KEYS_MAX` different lines are remembered; beyond that the
    one not seen for longest is forgotten.
    """

    def __init__(
        self, window_s: float, clock_s: Callable[[], float] = time.monotonic
    ) -> None:
        self.suppressed = 0  # lines dropped so far
        self._window_s = window_s
        self._clock_s = clock_s
        self._seen: dict[str, _Repeats] = {}

    def __call__(self, _logger: object, _method: str, event: EventDict) -> EventDict:
        """Return `event`, with ``suppressed`` if lines were left out; or raise DropEvent."""
        allowed = ALLOWED_AT_ONCE if event.get("kind") in _OFTEN else 1
        text = _NUMBERS.sub("#", str(event.get("event")))
        key = _NUMBERS.sub("#", repr(sorted(event.items())))
        now_s = self._clock_s()
        repeats = self._seen.pop(key, None)
        if repeats is None or now_s - repeats.begin_s >= self._window_s:
            if repeats is not None and repeats.suppressed:
                event["suppressed"] = repeats.suppressed
            newest = _Repeats(text, now_s)
            while len(self._seen) >= KEYS_MAX:
                del self._seen[next(iter(self._seen))]
            self._seen[key] = newest
            return event
        self._seen[key] = repeats
        if repeats.passed < allowed:
            repeats.passed += 1
            return event
        repeats.suppressed += 1
        self.suppressed += 1
        raise structlog.DropEvent

    def take_finished(self, *, all_windows: bool = False) -> list[tuple[str, int]]:
        """Return and forget (text, lines left out) of the windows that are over.

        Called from time to time, as the end of a burst may be followed by no further line.
        """
        now_s = self._clock_s()
        over = {
            key: repeats
            for key, repeats in self._seen.items()
            if all_windows or now_s - repeats.begin_s >= self._window_s
        }
        for key in over:
            del self._seen[key]
        return [(r.text, r.suppressed) for r in over.values() if r.suppressed]


def setup_logging(
    level: str = "INFO",
    line_format: str = "auto",
    repeat_window_s: float = 10.0,
    stream: Stream | None = None,
    clock_s: Callable[[], float] = time.monotonic,
) -> RepeatLimiter:
    """Set up structlog and the standard library's logging; may be called again.

    Pass the result to `report_repeats` from time to time.
    """
    out = sys.stderr if stream is None else stream
    is_console = is_readable(line_format, out)
    limiter = RepeatLimiter(repeat_window_s, clock_s)
    number = logging.getLevelNamesMapping()[level]
    processors = [
        _add_logger_name,
        structlog.processors.add_log_level,
        _in_a_sentence,
        _printable,
        limiter,
        *_rendering(is_console, colors=out.isatty()),
    ]

    def factory(*names: Any) -> _StreamLogger:
        return _StreamLogger(out, str(names[0]) if names else "")

    structlog.configure(
        processors=processors,
        wrapper_class=structlog.make_filtering_bound_logger(number),
        logger_factory=factory,
        cache_logger_on_first_use=False,
    )
    logging.basicConfig(handlers=[_ToStructlog()], level=number, force=True)
    for library in LIBRARIES:
        logging.getLogger(library).setLevel(max(number, logging.WARNING))
    return limiter


def is_readable(line_format: str, out: Stream) -> bool:
    """Whether lines on `out` are for people: as requested, or because `out` is a terminal."""
    return line_format == "console" or (line_format == "auto" and out.isatty())


def _rendering(is_console: bool, *, colors: bool) -> list[Any]:
    if not is_console:
        stamp = structlog.processors.TimeStamper(fmt="iso", utc=True)
        json = structlog.processors.JSONRenderer()
        return [stamp, structlog.processors.format_exc_info, json]
    plain = structlog.dev.plain_traceback
    console = structlog.dev.ConsoleRenderer(colors=colors, exception_formatter=plain)
    return [
        _drop_what_is_for_programs,
        structlog.processors.TimeStamper(fmt="%H:%M:%S", utc=False),
        console,
    ]


def notice(text: str, **details: object) -> None:
    """Log the result of an explicit request, such as a reload, whatever the level."""
    everything = structlog.make_filtering_bound_logger(logging.NOTSET)
    logger = structlog.get_config()["logger_factory"]("hilserver")
    structlog.wrap_logger(logger, wrapper_class=everything).info(text, **details)


def report_repeats(limiter: RepeatLimiter, *, at_end: bool = False) -> None:
    """Log the suppressed lines of windows that are over; `at_end`: of all windows."""
    log = structlog.get_logger(__name__)
    for text, suppressed in limiter.take_finished(all_windows=at_end):
        log.info("repeated lines left out", reason=text, suppressed=suppressed)


def log_overrun(overrun: "OverrunReport") -> None:
    """Log an overrun with its cause; as an error if it had a consequence."""
    log = structlog.get_logger("hilserver.scheduler")
    write = log.error if overrun.consequence else log.warning
    write(
        str(overrun),
        slice=overrun.slice,
        kind=str(overrun.kind),
        cause=str(overrun.cause),
        tick=overrun.tick,
    )


def log_event(event: Event) -> None:
    """Log an event of the bus; overruns have their own line with more figures (`log_overrun`)."""
    if event.kind is EventKind.OVERRUN:
        return
    log = structlog.get_logger("hilserver.events")
    if event.severity >= 700:
        write = log.error
    elif event.severity >= 300:
        write = log.warning
    else:
        write = log.info
    write(event.message, kind=str(event.kind), source=event.source)


class _StreamLogger:
    """Writes finished lines; a stream that is gone must not stop the robot."""

    def __init__(self, stream: Stream, name: str) -> None:
        self.name = name
        self._stream = stream

    def msg(self, line: str) -> None:
        with contextlib.suppress(OSError, ValueError):
            encoding = getattr(self._stream, "encoding", None) or "utf-8"
            self._stream.write(
                line.encode(encoding, "backslashreplace").decode(encoding) + "\n"
            )
            self._stream.flush()

    debug = info = warning = error = critical = exception = log = msg


class _ToStructlog(logging.Handler):
    """Hands records of the standard library to structlog."""

    def emit(self, record: logging.LogRecord) -> None:
        try:
            text = record.getMessage()
        except Exception:  # noqa: BLE001 (wrong arguments of a library)
            text = str(record.msg)
        # structlog knows five levels; a library may have its own between them
        standard = min(max(record.levelno // 10 * 10, logging.DEBUG), logging.CRITICAL)
        error = record.exc_info[1] if record.exc_info else None
        details: dict[str, Any] = {"exc_info": error} if error else {}
        if error and record.name.partition(".")[0] == TRACING_LIBRARY:
            details = {"error": f"{type(error).__name__}: {error}".removesuffix(": ")}
        structlog.get_logger(record.name).log(standard, text, **details)


def _in_a_sentence(_logger: object, _method: str, event: EventDict) -> EventDict:
    """Replace the traceback of an expected error by its sentence."""
    info = event.pop("exc_info", None)
    if info is True:
        info = sys.exc_info()
    error = info[1] if isinstance(info, tuple) else info
    if isinstance(error, EXPECTED_ERRORS):
        event["error"] = f"{type(error).__name__}: {error}".removesuffix(": ")
    elif error:
        event["exc_info"] = error
    return event


def _add_logger_name(logger: Any, _method: str, event: EventDict) -> EventDict:
    name = getattr(logger, "name", "")
    if name:
        event["logger"] = name
    return event


def _drop_what_is_for_programs(
    _logger: Any, _method: str, event: EventDict
) -> EventDict:
    for key in ("logger", "details"):
        event.pop(key, None)
    return event


def _printable(_logger: object, _method: str, event: EventDict) -> EventDict:
    """Limit every text and escape what could forge lines or control a terminal."""
    for name, value in event.items():
        if isinstance(value, str):
            text = value
            if len(text) > TEXT_LENGTH_MAX:
                more = len(text) - TEXT_LENGTH_MAX
                text = f"{text[:TEXT_LENGTH_MAX]}... ({more} characters more)"
            if text.isprintable():
                event[name] = text
            else:
                event[name] = "".join(
                    c if c.isprintable() else c.encode("unicode_escape").decode()
                    for c in text
                )
    return event
