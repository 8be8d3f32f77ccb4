"""Communication slices: run on the event loop when the doorbell rings, in every back end.

They have their own statistics. If the event loop is late and finds several announcements of the
same slice, the callback runs once, for the newest; the others are counted as missed.
"""

import asyncio
import time
from collections.abc import Callable, Iterator

import numpy as np

from hilserver.scheduler import exchange as ex
from hilserver.scheduler import law as lw
from hilserver.scheduler.machine import Machine
from hilserver.scheduler.statistics import row_offset
from hilserver.scheduler.statistics_rows import record_run

SliceCallback = Callable[[int, int], None]  # ``(tick, planned_ns)``


class Communication:
    """Calls the callbacks registered for each communication slice.

    In virtual time planned starts are simulated, so latency has no meaning and is 0.
    """

    def __init__(
        self,
        machine: Machine,
        *,
        simulated: bool,
        on_overrun: Callable[[str, int, int, int, int, int], None],
    ) -> None:
        self._machine = machine
        self._simulated = simulated
        self._on_overrun = on_overrun
        self._callbacks: dict[str, list[SliceCallback]] = {
            part.name: [] for part in machine.communication
        }
        self._seen = [0] * len(machine.communication)
        self._newest = np.zeros(2, dtype=np.int64)

    def add(self, name: str, callback: SliceCallback) -> None:
        """Call `callback` in every run of slice `name`."""
        if name not in self._callbacks:
            known = ", ".join(self._callbacks) or "there are none"
            raise KeyError(f"no communication slice {name!r} ({known})")
        self._callbacks[name].append(callback)

    def dispatch(self) -> None:
        """Run every slice announced since the last call."""
        for index, tick, planned_ns, missed in list(self._announced()):
            self._run(index, tick, planned_ns, missed)

    def _announced(self) -> Iterator[tuple[int, int, int, int]]:
        for index, seen in enumerate(self._seen):
            number = int(ex.announced(self._machine.exchange.comm, index, self._newest))
            if number <= seen:
                continue
            self._seen[index] = number
            yield index, int(self._newest[0]), int(self._newest[1]), number - seen - 1

    def _run(self, index: int, tick: int, planned_ns: int, missed: int) -> None:
        part = self._machine.communication[index]
        start_ns = time.monotonic_ns()
        for callback in self._callbacks[part.name]:
            self._call(part.name, callback, tick, planned_ns)
        end_ns = time.monotonic_ns()
        if self._machine.warming_up:
            return
        execution_ns = end_ns - start_ns
        period_ns = part.period_ticks * self._machine.exchange.get(ex.PACED_PERIOD)
        # A run for several announcements is as late as the first of them.
        latency_ns = (
            0 if self._simulated else start_ns - planned_ns + missed * period_ns
        )
        margin_ns = period_ns - latency_ns - execution_ns
        kind = lw.NO_OVERRUN
        if (margin_ns < 0 or missed) and not self._simulated:
            kind = lw.LATE_WAKE if latency_ns >= execution_ns else lw.LONG_RUN
        row = row_offset(len(self._machine.compiled) + index)
        stats = self._machine.statistics.array
        record_run(
            stats,
            row,
            tick,
            start_ns,
            latency_ns,
            execution_ns,
            margin_ns,
            kind,
            missed,
        )
        if kind != lw.NO_OVERRUN:
            self._on_overrun(part.name, kind, tick, latency_ns, execution_ns, missed)

    @staticmethod
    def _call(name: str, callback: SliceCallback, tick: int, planned_ns: int) -> None:
        try:
            callback(tick, planned_ns)
        except Exception as error:  # noqa: BLE001 - one slice must not stop the others
            asyncio.get_running_loop().call_exception_handler(
                {"message": f"slice {name!r} failed in tick {tick}", "exception": error}
            )
