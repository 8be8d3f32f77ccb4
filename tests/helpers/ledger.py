"""What each folder of tests costs: ``pytest -p tests.helpers.ledger tests/ROOM`` prints its row.

CPU time is that of this process and of children that have ended; it hardly depends on what else the
computer does. It is counted in loops of `hilserver.bench.report.loop_s`, which makes rows of
different computers comparable.
"""

import resource
import subprocess
import time
from collections import Counter, defaultdict

import pytest

from hilserver.bench.report import loop_s
from hilserver.compiled.cache import shelf

COLUMNS = ("tests", "CPU, loops", "CPU, s", "wall, s", "steps compiled", "processes")
ROOMS: dict[str, Counter[str]] = defaultdict(Counter)
_started: Counter[str] = Counter()


def room_of(nodeid: str) -> str:
    """Return the folder directly below `tests`, or the file."""
    return nodeid.partition("::")[0].removeprefix("tests/").partition("/")[0]


def _cpu_s() -> float:
    own, children = map(
        resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime


def _steps() -> int:
    return len(list(shelf().folder.glob("step_*.py")))


class _Counted(subprocess.Popen):
    def __init__(self, *args, **options):
        _started["processes"] += 1
        super().__init__(*args, **options)


def pytest_configure():
    subprocess.Popen = _Counted


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    cpu_s, wall_s, steps, started = (
        _cpu_s(),
        time.monotonic(),
        _steps(),
        _started["processes"],
    )
    try:
        return (yield)
    finally:
        row = ROOMS[room_of(item.nodeid)]
        row["tests"] += 1
        row["CPU, s"] += _cpu_s() - cpu_s
        row["wall, s"] += time.monotonic() - wall_s
        row["steps compiled"] += _steps() - steps
        row["processes"] += _started["processes"] - started


def pytest_terminal_summary(terminalreporter):
    loop = loop_s()
    terminalreporter.section(f"ledger, a loop takes {loop:.2f} s here")
    terminalreporter.line(f"| folder | {' | '.join(COLUMNS)} |")
    for room, row in sorted(ROOMS.items(), key=lambda pair: -pair[1]["CPU, s"]):
        row["CPU, loops"] = row["CPU, s"] / loop
        cells = " | ".join(f"{row[column]:.0f}" for column in COLUMNS)
        terminalreporter.line(f"| {room} | {cells} |")
