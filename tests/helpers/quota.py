"""A control group that grants its processes a part of a core, and a daemon that starts in it.

``python -m tests.helpers.quota ARGUMENTS`` is ``hilserver ARGUMENTS`` within the group that
`GROUP` in the environment names.
"""

import contextlib
import os
import sys
import time
from collections.abc import Iterator
from pathlib import Path

GROUP = "HILSERVER_TEST_GROUP"
PERIOD_US = 100_000
_V1, _V2 = Path("/sys/fs/cgroup/cpu"), Path("/sys/fs/cgroup")
_EMPTY_WITHIN_S = 30.0


@contextlib.contextmanager
def control_group(share: float) -> Iterator[Path]:
    """Make a group with so much of one core, until all of its processes have ended."""
    if os.geteuid() != 0:
        raise PermissionError(
            "a quota of a core needs root, who may make control groups"
        )
    is_old = (_V1 / "cpu.cfs_quota_us").exists() or (_V1 / "cgroup.procs").exists()
    group = (_V1 if is_old else _V2) / f"hilserver-test-{os.getpid()}"
    group.mkdir()
    try:
        quota_us = round(share * PERIOD_US)
        if is_old:
            (group / "cpu.cfs_period_us").write_text(f"{PERIOD_US}")
            (group / "cpu.cfs_quota_us").write_text(f"{quota_us}")
        else:
            (_V2 / "cgroup.subtree_control").write_text("+cpu")
            (group / "cpu.max").write_text(f"{quota_us} {PERIOD_US}")
        yield group
    finally:
        end_s = time.monotonic() + _EMPTY_WITHIN_S
        while (group / "cgroup.procs").read_text() and time.monotonic() < end_s:
            time.sleep(0.1)
        group.rmdir()


if __name__ == "__main__":
    Path(os.environ[GROUP], "cgroup.procs").write_text(f"{os.getpid()}")
    from hilserver.commands import main

    sys.exit(main(sys.argv[1:]))
