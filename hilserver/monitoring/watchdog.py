"""Ready, alive, state: what a running daemon reports to the service manager.

The watchdog is fed by the heartbeat of the paced loop, never by the event loop alone: systemd gets
WATCHDOG=1 only if the plant has woken up since the last time. So systemd ends the process if either
the plant or the event loop freezes.
"""

import contextlib
import os
import socket
import time
from collections.abc import AsyncIterator, Callable, Iterator

from hilserver.tasks import Supervisor

FEEDS_PER_PERIOD = 4
LONGEST_LOOK_S = 0.5  # state and readiness are checked at least this often


def notify(*assignments: str) -> bool:
    """Send assignments such as ``READY=1`` to the service manager; False if none listens."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address:
        return False
    if address.startswith("@"):  # an abstract socket
        address = "\0" + address[1:]
    try:
        with socket.socket(
            socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC
        ) as sender:
            sender.setblocking(False)  # a full queue must not stop the event loop
            sender.sendto("\n".join(assignments).encode(), address)
    except OSError:
        return False
    return True


def watchdog_period_s() -> float | None:
    """Return how long [s] the service manager tolerates silence; None: for ever."""
    pid = os.environ.get("WATCHDOG_PID", "")
    period_us = os.environ.get("WATCHDOG_USEC", "")
    if not period_us.isdigit() or pid not in ("", str(os.getpid())):
        return None
    return int(period_us) / 1e6 or None


class Watchdog:
    """Reports to the service manager."""

    def __init__(
        self,
        *,
        heartbeat_ns: Callable[[], int],
        ready: Callable[[], bool],
        status: Callable[[], str],
        send: Callable[..., bool] = notify,
        tasks: Supervisor | None = None,
    ) -> None:
        self._tasks = Supervisor() if tasks is None else tasks
        self._heartbeat_ns = heartbeat_ns
        self._ready = ready
        self._status = status
        self._send = send
        self._is_ready = False
        self._last_beat_ns = 0
        self._last_status = ""

    def look(self) -> None:
        """Send what has changed since the last look."""
        messages = []
        if not self._is_ready and self._ready():
            self._is_ready = self._send("READY=1")
        beat_ns = self._heartbeat_ns()
        if beat_ns != self._last_beat_ns:
            self._last_beat_ns = beat_ns
            messages.append("WATCHDOG=1")
        status = self._status()
        if status != self._last_status:
            self._last_status = status
            messages.append(f"STATUS={status}")
        if messages:
            self._send(*messages)

    @contextlib.contextmanager
    def reloading(self) -> Iterator[None]:
        """Enclose a reload: the service manager shows it as such."""
        if self._is_ready:
            self._send("RELOADING=1", f"MONOTONIC_USEC={time.monotonic_ns() // 1000}")
        try:
            yield
        finally:
            if self._is_ready:
                self._send("READY=1")

    @contextlib.asynccontextmanager
    async def watching(self) -> AsyncIterator[None]:
        """Look repeatedly; at the end report that the daemon is stopping."""
        period_s = watchdog_period_s()
        pause_s = LONGEST_LOOK_S
        if period_s is not None:
            pause_s = min(pause_s, period_s / FEEDS_PER_PERIOD)
        job = self._tasks.every("watchdog", pause_s, self.look)
        try:
            yield
        finally:
            job.cancel()
            self._send("STOPPING=1", "STATUS=stopping")
