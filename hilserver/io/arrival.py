"""When bytes reached this computer; our event loop may have stood until it read them."""

import socket
import sys
import time
from typing import Any, Final

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
