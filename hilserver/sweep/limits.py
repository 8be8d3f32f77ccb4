"""What a machine may use of its worker: limited time and memory, and no output."""

import atexit
import contextlib
import os
import resource
import signal
import threading
from collections.abc import Iterator
from pathlib import Path

# extra time until the kernel ends a worker whose code cannot be interrupted
GRACE_S = 5.0
_SILENCE = Path(os.devnull).open("w", encoding="utf-8", errors="replace")  # noqa: SIM115
"""Open to the end: controllers may keep it, and overlapping threads may restore it."""
atexit.register(_SILENCE.close)


class OutOfTime(BaseException):
    """The machine's time is over; a controller's 'except Exception' does not catch it."""


@contextlib.contextmanager
def limited(time_s: float) -> Iterator[None]:
    """Raise `OutOfTime` in the block after `time_s`; end the process a little later.

    Python code is interrupted in the main thread of a process, where the signal arrives. Compiled
    code, and threads of a Dask worker, are ended with their process, which the submitter notices.
    """
    in_main = threading.current_thread() is threading.main_thread()
    before = signal.signal(signal.SIGALRM, _over) if in_main else None
    signal.setitimer(signal.ITIMER_REAL, time_s + (0.0 if in_main else GRACE_S))
    # Nobody handles SIGPROF: it ends a process that computes on where `_over` is never called.
    signal.setitimer(signal.ITIMER_PROF, time_s + GRACE_S)
    try:
        with contextlib.redirect_stdout(_SILENCE), contextlib.redirect_stderr(_SILENCE):
            yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        if in_main:
            signal.signal(signal.SIGALRM, before)


def _over(_number: int, _frame: object) -> None:
    raise OutOfTime


def limit_memory(megabytes: float) -> None:
    """Let this process have this much more memory than it has now."""
    has = 0
    with contextlib.suppress(OSError):
        words = Path("/proc/self/statm").read_text(encoding="ascii").split()
        has = int(words[0]) * resource.getpagesize()
    most = has + int(megabytes * 1e6)
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    if has and (hard == resource.RLIM_INFINITY or most < hard):
        resource.setrlimit(resource.RLIMIT_AS, (most, hard))
