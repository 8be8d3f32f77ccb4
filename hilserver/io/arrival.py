"""When data that a link reads arrived at this computer; we may have stood still meanwhile."""

import socket
import sys
import time
from typing import Any, Final

WATCH_S: Final = 0.02
WATCH_NS: Final = round(WATCH_S * 1e9)
LEFT_OVER_NS: Final = 100_000_000
LEFT_OVER_SHARE: Final = 10
"""Time after a standstill, at least or as a share of it, in which data may be as old as it."""
_LENGTH: Final = 56
_LAST_RECEIVED: Final = slice(52, 56)  # tcpi_last_data_recv [ms]
_GRAIN_MS: Final = 10  # the longest tick in which the kernel counts


def came_ns(connection: Any) -> int:
    """Return when the newest data of a TCP connection came in (CLOCK_MONOTONIC).

    Now, if the kernel does not report it: other kinds of sockets, or a closed one.
    """
    now_ns = time.monotonic_ns()
    try:
        info = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _LENGTH)
    except OSError:
        return now_ns
    age_ms = int.from_bytes(info[_LAST_RECEIVED], sys.byteorder)
    return now_ns - age_ms * 1_000_000 if age_ms > _GRAIN_MS else now_ns


class Arrivals:
    """Dates data that has no time of arrival: now, except after a standstill of ours.

    After one it may be as old as the standstill, and its sender gone. `limit_ns`: standstill that a
    command does not survive. `left_over_ns`: least time until all that waited has been read.
    """

    def __init__(self, limit_ns: int, left_over_ns: int = LEFT_OVER_NS) -> None:
        self._limit_ns = limit_ns
        self._least_ns = left_over_ns
        # 0: not yet
        self._looked_ns = self._stood_since_ns = self._left_over_until_ns = 0

    def came_ns(self, now_ns: int) -> int:
        """Return when the data that is read now came in."""
        self._note_standstill(now_ns)
        return self._stood_since_ns if now_ns < self._left_over_until_ns else now_ns

    def look(self, now_ns: int) -> None:
        """Note that we are running; called every `WATCH_S`."""
        self._note_standstill(now_ns)
        self._looked_ns = now_ns

    def _note_standstill(self, now_ns: int) -> None:
        stood_ns = now_ns - self._looked_ns
        if not self._looked_ns or stood_ns <= WATCH_NS + self._limit_ns:
            return
        draining_ns = max(self._least_ns, stood_ns // LEFT_OVER_SHARE)
        self._stood_since_ns = self._looked_ns
        self._left_over_until_ns = now_ns + draining_ns
        self._looked_ns = now_ns
