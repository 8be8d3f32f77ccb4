"""asyncua's log as one line per message: no tracebacks, repeated lines counted.

A client that disconnects in the middle of an answer is no fault of the server, yet asyncua logs it
with a traceback. Every record of its server side comes through here.
"""

import logging
import time
from collections.abc import Callable

import structlog

_LOGGERS = ("asyncua.server", "asyncua.crypto", "asyncua.ua", "asyncua.uaprotocol")
_REPEAT_AFTER_S = 10.0
_LONGEST_LINE = 300
_MOST_KEYS = 500

log = structlog.get_logger("hilserver.opcua")


class OneLineHandler(logging.Handler):
    """Hands records to structlog; the same message at most once in ten seconds, with a count."""

    def __init__(self, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        super().__init__(logging.WARNING)
        self._monotonic_s = monotonic_s
        # Keyed by the text in asyncua's source: about as many as it has log calls.
        self._last: dict[tuple[str, str], tuple[float, int]] = {}

    def emit(self, record: logging.LogRecord) -> None:
        """Log one record."""
        key = (record.name, str(record.msg))
        now_s = self._monotonic_s()
        last_s, repeated = self._last.get(key, (float("-inf"), 0))
        if now_s - last_s < _REPEAT_AFTER_S:
            self._last[key] = (last_s, repeated + 1)
            return
        if len(self._last) >= _MOST_KEYS:
            self._last.clear()
        self._last[key] = (now_s, 0)
        more = {"repeated": repeated} if repeated else {}
        log.warning("opcua library", detail=one_line(record), part=record.name, **more)


def one_line(record: logging.LogRecord) -> str:
    """Return message and exception of a record as one short line."""
    try:
        text = record.getMessage()
    except (TypeError, ValueError):
        text = str(record.msg)
    if record.exc_info and record.exc_info[1] is not None:
        error = record.exc_info[1]
        text = f"{text} ({type(error).__name__}: {error})"
    text = " ".join(text.split())
    return text if len(text) <= _LONGEST_LINE else text[: _LONGEST_LINE - 3] + "..."


def tame_library_log() -> None:
    """Send the log of asyncua's server side through `OneLineHandler`; once is enough."""
    for name in _LOGGERS:
        logger = logging.getLogger(name)
        if not any(isinstance(handler, OneLineHandler) for handler in logger.handlers):
            logger.addHandler(OneLineHandler())
        logger.propagate = False
        logger.setLevel(logging.WARNING)
