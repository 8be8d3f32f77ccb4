"""What the pacing thread requests from the operating system, and what it was granted.

Every request, granted or not, gives an `AuditFinding` that the audit shows. Only the pacing thread
gets a real-time priority, never the process, as children would inherit it.
"""

import contextlib
import ctypes
import os
import resource
import signal
import threading
from dataclasses import dataclass
from pathlib import Path

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
_PR_SET_TIMERSLACK = 29
_LATENCY_TARGET = Path("/dev/cpu_dma_latency")
CAP_IPC_LOCK, CAP_SYS_NICE = 14, 23


@dataclass(frozen=True, slots=True)
class RealtimeSettings:
    """What to request."""

    # SCHED_FIFO priority of the pacing thread, 1 to 99; 0: do not ask
    priority: int = 80
    cpu: int | None = None  # pin the pacing thread to this core
    lock_memory: bool = True  # lock and prefault the memory of the process
    # hold /dev/cpu_dma_latency open with 0, so that no core sleeps deeply
    hold_latency_target: bool = True

    def __post_init__(self) -> None:
        if not 0 <= self.priority <= 99:
            raise ValueError(
                f"the real-time priority must be 0 (off) to 99, not {self.priority}"
            )


@dataclass(frozen=True, slots=True)
class AuditFinding:
    """The answer to one request, or another finding of the audit."""

    name: str  # snake case; label of the metric
    ok: bool
    # in words
    found: str
    wanted: str
    remedy: str = ""  # what to do; empty if `ok` or if nothing can be done


class ProcessGrants:
    """Requests for the whole process; `release` reverts them."""

    def __init__(self, settings: RealtimeSettings) -> None:
        self._settings = settings
        self._latency_target: int | None = None
        self._locked = False
        self._cores: set[int] | None = None

    def request(self) -> list[AuditFinding]:
        """Request what the settings contain."""
        grants = []
        if self._settings.cpu is not None:
            grants.append(self._leave_core(self._settings.cpu))
        if self._settings.lock_memory:
            grants.append(self._lock_memory())
        if self._settings.hold_latency_target:
            grants.append(self._hold_latency_target())
        return grants

    def release(self) -> None:
        """Revert everything; may be called twice."""
        if self._latency_target is not None:
            os.close(self._latency_target)
            self._latency_target = None
        if self._cores is not None:
            _move_all_threads(self._cores)
            self._cores = None
        if self._locked:
            ctypes.CDLL(None).munlockall()
            self._locked = False

    def _leave_core(self, cpu: int) -> AuditFinding:
        """Move all other threads, and those started later, to other cores.

        A priority does not help against a long system call of another thread on the same core,
        unless the kernel is preemptible.
        """
        wanted = f"core {cpu} for the pacing thread alone"
        cores = os.sched_getaffinity(0)
        others = cores - {cpu}
        if not others:
            return AuditFinding(
                "core_of_its_own", False, "the only core", wanted, "use a second core"
            )
        _move_all_threads(others)
        self._cores = cores
        return AuditFinding(
            "core_of_its_own", True, f"the rest on {sorted(others)}", wanted
        )

    def _lock_memory(self) -> AuditFinding:
        limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
        remedy = "LimitMEMLOCK=infinity in the unit, or ulimit -l unlimited"
        # With a finite limit and MCL_FUTURE a later allocation would fail in the middle of the run.
        if limit != resource.RLIM_INFINITY and not has_capability(CAP_IPC_LOCK):
            return AuditFinding(
                "memory_lock", False, f"limit {limit // 1024} KiB", "locked", remedy
            )
        libc = ctypes.CDLL(None, use_errno=True)
        # ONFAULT: what is never touched, such as most of a thread's stack, takes no memory.
        if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) != 0:
            return AuditFinding(
                "memory_lock", False, os.strerror(ctypes.get_errno()), "locked", remedy
            )
        self._locked = True
        return AuditFinding("memory_lock", True, "locked", "locked")

    def _hold_latency_target(self) -> AuditFinding:
        try:
            self._latency_target = os.open(_LATENCY_TARGET, os.O_WRONLY | os.O_CLOEXEC)
            os.write(self._latency_target, b"\0\0\0\0")
        except OSError as error:
            remedy = f"give the user write access to {_LATENCY_TARGET} (a udev rule)"
            found = error.strerror or "error"
            return AuditFinding("latency_target", False, found, "0 us, held", remedy)
        return AuditFinding("latency_target", True, "0 us, held", "0 us, held")


def request_for_this_thread(settings: RealtimeSettings) -> list[AuditFinding]:
    """Request priority, core and timer slack for the calling thread; block all its signals."""
    with contextlib.suppress(ValueError, OSError):
        signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
    grants = [_timer_slack()]
    if settings.cpu is not None:
        grants.append(_pin(settings.cpu))
    if settings.priority > 0:
        grants.append(_real_time_priority(settings.priority))
    return grants


def _move_all_threads(cpus: set[int]) -> None:
    for thread in Path("/proc/self/task").iterdir():
        with contextlib.suppress(OSError):  # the thread has ended meanwhile
            os.sched_setaffinity(int(thread.name), cpus)


def _timer_slack() -> AuditFinding:
    if ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0) != 0:
        return AuditFinding(
            "timer_slack", False, os.strerror(ctypes.get_errno()), "1 ns"
        )
    return AuditFinding("timer_slack", True, "1 ns", "1 ns")


def _pin(cpu: int) -> AuditFinding:
    try:
        os.sched_setaffinity(threading.get_native_id(), {cpu})
    except (OSError, ValueError, OverflowError) as error:
        remedy = f"choose one of {sorted(os.sched_getaffinity(0))}"
        return AuditFinding("thread_core", False, str(error), f"core {cpu}", remedy)
    return AuditFinding("thread_core", True, f"core {cpu}", f"core {cpu}")


def _real_time_priority(priority: int) -> AuditFinding:
    wanted = f"SCHED_FIFO {priority}"
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    try:
        os.sched_setscheduler(
            threading.get_native_id(), policy, os.sched_param(priority)
        )
    except OSError as error:
        remedy = f"LimitRTPRIO={priority} in the unit, or ulimit -r {priority}"
        return AuditFinding(
            "thread_priority", False, error.strerror or "error", wanted, remedy
        )
    return AuditFinding("thread_priority", True, wanted, wanted)


def has_capability(number: int, root: Path = Path("/")) -> bool:
    """Return whether this process has a capability, read from ``proc`` below `root`."""
    with contextlib.suppress(OSError):
        for line in (
            (root / "proc/self/status").read_text(encoding="utf-8").splitlines()
        ):
            if line.startswith("CapEff:"):
                return bool(int(line.split()[1], 16) >> number & 1)
    return False
