"""``python -m hilserver.io.page.quietly COMMAND ...``: run a command of ours in the background.

It gets only processor time that nothing else needs, and limited memory.
"""

import os
import resource
import sys

from hilserver.program.workers import lower

MEMORY_BYTES = 4 << 30


def main() -> None:
    """Lower priority and limits, then exec the command."""
    lower(19)
    if hasattr(os, "SCHED_IDLE"):
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    limit = MEMORY_BYTES if hard == resource.RLIM_INFINITY else min(MEMORY_BYTES, hard)
    resource.setrlimit(resource.RLIMIT_DATA, (limit, hard))
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    os.execv(sys.executable, [sys.executable, "-m", "hilserver", *sys.argv[1:]])  # noqa: S606


if __name__ == "__main__":
    main()
