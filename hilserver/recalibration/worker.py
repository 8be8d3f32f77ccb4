"""The process of one look: ``python -m hilserver.recalibration.worker ORDER``.

It has low priority, its own cores and bounded memory, and ends with the daemon in any case.
"""

import contextlib
import os
import resource
import sys
from pathlib import Path

from hilserver.program.workers import end_with_parent, lower
from hilserver.recalibration.orders import JudgeOrder, JudgeResult, Share


def take(share: Share) -> None:
    """Limit this process to its share of the computer."""
    lower(share.nice)
    if share.cpus:
        with contextlib.suppress(OSError):  # the computer may not have that core
            os.sched_setaffinity(0, share.cpus)
    if share.memory_bytes:
        resource.setrlimit(
            resource.RLIMIT_DATA, (share.memory_bytes, share.memory_bytes)
        )
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def main() -> int:
    """Carry out an order; print its result as the only line."""
    order = JudgeOrder.of(Path(sys.argv[1]).read_text(encoding="utf-8"))
    if order.share.parent:
        end_with_parent(order.share.parent)
    take(order.share)
    try:
        from hilserver.recalibration.judging import OrderJudge  # noqa: PLC0415 - within its share

        result = OrderJudge(order).result()
    except MemoryError:
        limit = order.share.memory_bytes / 1e6
        result = JudgeResult(
            error=f"it needs more memory than recalibration.memory_mb, {limit:.0f} MB"
        )
    print(result.text(), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
