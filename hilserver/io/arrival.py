"""When what a link reads reached this computer; we may have stood until it was read."""

import socket
import sys
import time
from typing import Any, Final

WATCH_S: Final = 0.02
WATCH_NS: Final = round(WATCH_S * 1e9)
LEFT_OVER_NS: Final = 100_000_000
LEFT_OVER_SHARE: Final = 10
"""So long after a standstill of ours, or this part of it, what is read may be as old as that."""
_LENGTH: Final = 56
_LAST_RECEIVED: Final = slice(52, 56)  # tcpi_last_data_recv [ms]
_GRAIN_MS: Final = 10  # the kernel counts in its own ticks, of up to so much


def came_ns(connection: Any) -> int:
    """Return when the newest data of a TCP connection came in (CLOCK_MONOTONIC).

    Now, where the kernel does not say: other kinds of sockets, or one that is closed.
    """
    now_ns = time.monotonic_ns()
    try:
        info = connection.getsockopt(socket.IPPROTO_TCP, socket.TCP_INFO, _LENGTH)
    except OSError:
        return now_ns
    age_ms = int.from_bytes(info[_LAST_RECEIVED], sys.byteorder)
    return now_ns - age_ms * 1_000_000 if age_ms > _GRAIN_MS else now_ns


class Arrivals:
    """Dates what is read where nobody says when it came, which is now but behind a standstill.

    Then it may be as old as that, and whoever has sent it gone. `limit_ns`: a standstill that a
    command does not survive. `left_over_ns`: how long it takes at least until all is read.
    """

    def __init__(self, limit_ns: int, left_over_ns: int = LEFT_OVER_NS) -> None:
        self._limit_ns, self._least_ns = limit_ns, left_over_ns
        self._looked_ns = self._stood_since_ns = self._left_over_until_ns = 0  # 0: not yet

    def came_ns(self, now_ns: int) -> int:
        """Return when what is read now came in."""
        self._note_standstill(now_ns)
        return self._stood_since_ns if now_ns < self._left_over_until_ns else now_ns

    def look(self, now_ns: int) -> None:
        """Note that we do not stand; called every `WATCH_S`."""
        self._note_standstill(now_ns)
        self._looked_ns = now_ns

    def _note_standstill(self, now_ns: int) -> None:
        stood_ns = now_ns - self._looked_ns
        if not self._looked_ns or stood_ns <= WATCH_NS + self._limit_ns:
            return
        draining_ns = max(self._least_ns, stood_ns // LEFT_OVER_SHARE)
        self._stood_since_ns, self._left_over_until_ns = self._looked_ns, now_ns + draining_ns
        self._looked_ns = now_ns
