"""``python -m hilserver.io.page.quietly COMMAND ...``: a command of ours that disturbs nobody.

It gets only the time that nobody else wants, and a limit of memory.
"""

import contextlib
import os
import resource
import sys
from pathlib import Path

MEMORY_BYTES = 4 << 30


def main() -> None:
    """Lower priority and limits, then become the command."""
    os.nice(19)
    if os.getsid(0) == os.getpid():  # a session competes as a whole, with its own value: sched(7)
        with contextlib.suppress(OSError):
            Path("/proc/self/autogroup").write_text("19", encoding="ascii")
    if hasattr(os, "SCHED_IDLE"):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    limit = MEMORY_BYTES if hard == resource.RLIM_INFINITY else min(MEMORY_BYTES, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, hard))
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.execv(sys.executable, [sys.executable, "-m", "hilserver", *sys.argv[1:]])  # noqa: S606


if __name__ == "__main__":
    main()
