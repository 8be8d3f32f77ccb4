"""Why a tick was late or long, as far as the system shows.

For every overrun the pacing loop records the resource usage of its own thread in that tick
(processor time, page faults, involuntary switches). The rest is read from /proc afterwards, as the
difference to the last look (at most a second old):

============ ==================================================================================
``stopped``  the process was stopped (SIGSTOP, debugger): a SIGCONT arrived
``GC``       Python's garbage collector ran meanwhile (only if the event loop is involved)
``slice``    the slice itself: it computed for most of the time, or longer than a period
``fault``    a page had to be read from disk (major) or made (minor)
``stolen``   the hypervisor gave the core to another guest (steal time)
``preempted`` the thread was ready but another one ran (involuntary switches, run-queue delay)
``event_loop`` a communication slice: the event loop was busy with something else
``unknown``  none of these; interrupts and firmware (SMI) leave no trace here
============ ==================================================================================
"""

import os
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from hilserver.scheduler.exchange import OverrunRecord
from hilserver.scheduler.gc_pauses import GcPauses
from hilserver.scheduler.law import LATE_WAKE

_LOOK_NS = 1_000_000_000


class OverrunCause(StrEnum):
    """The words of the module's table."""

    STOPPED = "stopped"
    GC = "gc"
    SLICE = "slice"
    FAULT = "page_fault"
    STOLEN = "stolen"
    PREEMPTED = "preempted"
    EVENT_LOOP = "event_loop"
    UNKNOWN = "unknown"


@dataclass(frozen=True, slots=True)
class Look:
    """Running totals of the system [ns]."""

    at_ns: int
    run_delay_ns: int
    steal_ns: int


@dataclass(frozen=True, slots=True)
class OverrunEvidence:
    """What is known about one overrun; durations in ns."""

    span_ns: int  # the delay (late wake) or the execution (long run) to be explained
    period_ns: int  # more processor time than this alone explains a long run
    late: bool
    cpu_ns: int
    minor_faults: int
    major_faults: int
    preempted: int
    run_delay_ns: int
    steal_ns: int
    gc_ns: int
    stopped: bool


def judge(evidence: OverrunEvidence) -> OverrunCause:
    """Name the likeliest cause: the first that explains at least half of the span."""
    half = evidence.span_ns // 2
    if evidence.stopped:
        return OverrunCause.STOPPED
    if evidence.gc_ns >= half > 0:
        return OverrunCause.GC
    if not evidence.late and evidence.cpu_ns >= min(half, evidence.period_ns):
        return OverrunCause.SLICE
    if evidence.steal_ns >= half:
        return OverrunCause.STOLEN
    if evidence.run_delay_ns >= half:
        return OverrunCause.PREEMPTED
    if evidence.major_faults:
        return OverrunCause.FAULT
    if evidence.preempted and not evidence.late:
        return OverrunCause.PREEMPTED
    if evidence.minor_faults and not evidence.late:
        return OverrunCause.FAULT
    return OverrunCause.UNKNOWN


def read_run_delay_ns(thread_id: int, proc: Path = Path("/proc")) -> int:
    """Return how long a thread of this process has waited, ready, for a core [ns]; 0: unknown."""
    try:
        return int((proc / f"self/task/{thread_id}/schedstat").read_text().split()[1])
    except (OSError, IndexError, ValueError):
        return 0


def read_steal_ns(proc: Path = Path("/proc")) -> int:
    """Return the steal time of all cores [ns]; 0: unknown."""
    try:
        with (proc / "stat").open() as stat:
            fields = stat.readline().split()
        return int(fields[8]) * 1_000_000_000 // os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return 0


class CauseFinder:
    """Looks at the system regularly, so that an overrun can be explained afterwards.

    Garbage collections stop ticks only if the event loop itself paces (`timerfd`).
    """

    def __init__(
        self,
        thread_id: int,
        gc_pauses: GcPauses,
        *,
        period_ns: int,
        gc_stops_ticks: bool,
        clock_ns: Callable[[], int] = time.monotonic_ns,
        proc: Path = Path("/proc"),
    ) -> None:
        self._thread_id = thread_id
        self._gc_pauses = gc_pauses
        self._period_ns = period_ns
        self._gc_stops_ticks = gc_stops_ticks
        self._clock_ns = clock_ns
        self._proc = proc
        self._continued_ns: deque[int] = deque(maxlen=16)
        self._last = self.look()

    def continued(self) -> None:
        """Note a SIGCONT."""
        self._continued_ns.append(self._clock_ns())

    def look_around(self) -> None:
        """Refresh the running totals if they are older than a second."""
        if self._clock_ns() - self._last.at_ns >= _LOOK_NS:
            self._last = self.look()

    def explain(self, record: OverrunRecord, now: Look) -> OverrunCause:
        """Name the likeliest cause of one overrun of a compiled slice; `now` is a fresh look."""
        late = record.kind == LATE_WAKE
        began_ns = record.planned_ns if late else record.planned_ns + record.latency_ns
        span_ns = record.latency_ns if late else record.execution_ns
        end_ns = began_ns + span_ns
        gc_ns = (
            self._gc_pauses.overlap_ns(began_ns, end_ns) if self._gc_stops_ticks else 0
        )
        return judge(
            OverrunEvidence(
                span_ns=span_ns,
                period_ns=self._period_ns,
                late=late,
                cpu_ns=record.cpu_ns,
                minor_faults=record.minor_faults,
                major_faults=record.major_faults,
                preempted=record.preempted,
                run_delay_ns=now.run_delay_ns - self._last.run_delay_ns,
                steal_ns=now.steal_ns - self._last.steal_ns,
                gc_ns=gc_ns,
                stopped=self._was_stopped(began_ns, end_ns),
            )
        )

    def explain_communication(
        self, begin_ns: int, end_ns: int, *, late: bool
    ) -> OverrunCause:
        """Name the likeliest cause of an overrun of a communication slice."""
        if self._was_stopped(begin_ns, end_ns):
            return OverrunCause.STOPPED
        if self._gc_pauses.overlap_ns(begin_ns, end_ns) * 2 >= end_ns - begin_ns > 0:
            return OverrunCause.GC
        return OverrunCause.EVENT_LOOP if late else OverrunCause.SLICE

    def _was_stopped(self, begin_ns: int, end_ns: int) -> bool:
        # The handler runs on the event loop, hence a little after the process continues.
        return any(begin_ns <= at <= end_ns + 20_000_000 for at in self._continued_ns)

    def look(self) -> Look:
        """Read the running totals now."""
        return Look(
            self._clock_ns(),
            read_run_delay_ns(self._thread_id, self._proc),
            read_steal_ns(self._proc),
        )
