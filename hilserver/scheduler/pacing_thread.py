"""The default back end: a thread in compiled code that never needs the interpreter lock.

The thread sleeps on clock_nanosleep with absolute deadlines, runs the tick and rings an eventfd
when the event loop has something to do. Neither waits for the other.
"""

import asyncio
import atexit
import contextlib
import os
import threading
from collections.abc import Callable
from typing import TypeVar

from hilserver.errors import FailedError
from hilserver.scheduler.machine import Machine
from hilserver.scheduler.pacing import Ended, Rung, StopReason
from hilserver.scheduler.pacing_loop import pace
from hilserver.scheduler.realtime import (
    AuditFinding,
    ProcessGrants,
    RealtimeSettings,
    request_for_this_thread,
)
from hilserver.time_limit import time_limit

_END_WITHIN_S = 5.0

T = TypeVar("T")


class ThreadPacing:
    """Paces the machine in a thread of its own."""

    def __init__(
        self, machine: Machine, settings: RealtimeSettings, rung: Rung, ended: Ended
    ) -> None:
        self._machine = machine
        self._settings = settings
        self._rung = rung
        self._ended = ended
        self._process_grants = ProcessGrants(settings)
        self._thread = threading.Thread(target=self._run, name="pacing", daemon=True)
        self._doorbell = -1
        self._over = asyncio.Event()
        # the operating system's number of the pacing thread; 0 before the start
        self.thread_id = 0

    async def start(self) -> list[AuditFinding]:
        """Start the thread; return what the operating system granted."""
        self._loop = asyncio.get_running_loop()
        self._granted: asyncio.Future[list[AuditFinding]] = self._loop.create_future()
        self._doorbell = os.eventfd(0, os.EFD_NONBLOCK | os.EFD_CLOEXEC)
        self._loop.add_reader(self._doorbell, self._answer_doorbell)
        grants = self._process_grants.request()
        self._machine.prefault()
        self._thread.start()
        atexit.register(self._end_thread)
        return grants + await self._granted

    async def stop(self) -> None:
        """Wait for the thread's end; at most the longest sleep plus one tick."""
        try:
            async with time_limit(_END_WITHIN_S):
                if self._thread.ident is not None:
                    await self._over.wait()  # `join` alone would block the event loop
                    self._thread.join()
        except TimeoutError:
            raise FailedError(
                f"the pacing thread did not stop within {_END_WITHIN_S:g} s: a slice does not"
                f" return"
            ) from None
        atexit.unregister(self._end_thread)
        self._loop.remove_reader(self._doorbell)
        os.close(self._doorbell)
        self._process_grants.release()

    def wake(self) -> None:
        """Nothing to do: the thread looks at its control words at every wake-up."""

    def _answer_doorbell(self) -> None:
        with contextlib.suppress(BlockingIOError):
            os.eventfd_read(self._doorbell)
        self._rung()

    def _run(self) -> None:
        reason = StopReason.CRASHED
        try:
            self.thread_id = threading.get_native_id()
            grants = request_for_this_thread(self._settings)
            self._tell(self._granted.set_result, grants)
            failed = pace(self._machine.step, self._machine.loop, self._doorbell)
            reason = StopReason.OVERRUN if failed else StopReason.STOPPED
        finally:
            self._tell(self._finish, reason)

    def _finish(self, reason: StopReason) -> None:
        self._over.set()
        if not self._granted.done():
            self._granted.set_exception(
                RuntimeError("the pacing thread failed to start")
            )
        self._ended(reason)

    def _tell(self, function: Callable[[T], None], argument: T) -> None:
        with contextlib.suppress(RuntimeError):  # the event loop is closed
            self._loop.call_soon_threadsafe(function, argument)

    def _end_thread(self) -> None:
        """End the thread before the interpreter frees the arrays under it."""
        self._machine.exchange.request_stop()
        self._thread.join(_END_WITHIN_S)
