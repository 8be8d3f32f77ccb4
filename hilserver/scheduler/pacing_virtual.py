"""Virtual time: as fast as possible, in bounded batches that yield to the event loop.

Every communication slice runs at its own tick, so every run in virtual time is the same.
"""

import asyncio
import time
from collections.abc import Callable, Sequence

from hilserver.scheduler.law import begin
from hilserver.scheduler.machine import Machine
from hilserver.scheduler.pacing import Ended, Rung, StopReason
from hilserver.scheduler.pacing_loop import run_batch
from hilserver.scheduler.realtime import AuditFinding
from hilserver.scheduler.turn import ENDED, RING, STANDING
from hilserver.tasks import Supervisor
from hilserver.time_limit import time_limit

BATCH_TICKS = 1000
_PAUSED_POLL_S = 0.01  # while paused, inputs are latched at least this often


class VirtualPacing:
    """Runs the machine in virtual time; `thread_id` is 0, as there is nothing to attribute.

    Time waits for the functions `after_batch`, which are called at least every `BATCH_TICKS`.
    """

    def __init__(
        self,
        machine: Machine,
        rung: Rung,
        ended: Ended,
        after_batch: Sequence[Callable[[], None]] = (),
        tasks: Supervisor | None = None,
    ) -> None:
        self._tasks = Supervisor() if tasks is None else tasks
        self._after_batch = after_batch
        self._machine = machine
        self._rung = rung
        self._ended = ended
        self._wake = asyncio.Event()
        self._stopping = False
        self.thread_id = 0

    async def start(self) -> list[AuditFinding]:
        """Start the task that runs the batches."""
        self._machine.prefault()
        begin(self._machine.law, time.monotonic_ns())
        self._job = self._tasks.spawn(self._run, "virtual pacing")
        return []

    async def stop(self) -> None:
        """End the task."""
        self._stopping = True
        self._wake.set()
        if self._job.task is not asyncio.current_task():
            await asyncio.wait({self._job.task})

    def wake(self) -> None:
        """Look at the control words at once, because a command has been given."""
        self._wake.set()

    async def _run(self) -> None:
        reason = StopReason.CRASHED
        try:
            while not self._stopping:
                flags = run_batch(self._machine.step, self._machine.loop, BATCH_TICKS)
                if flags & RING:
                    self._rung()
                for look in self._after_batch:
                    look()
                if flags & ENDED:
                    reason = StopReason.OVERRUN
                    return
                if flags & STANDING:
                    await self._wait_for_command()
                else:
                    await asyncio.sleep(0)
            reason = StopReason.STOPPED
        finally:
            self._ended(reason)

    async def _wait_for_command(self) -> None:
        try:
            async with time_limit(_PAUSED_POLL_S):
                await self._wake.wait()
        except TimeoutError:
            return
        self._wake.clear()
