"""cyclictest, the reference for wake latency: run it once, read its histogram."""

import contextlib
import re
import shutil
import subprocess
import time
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from hilserver.errors import FailedError
from hilserver.program.children import piped

_SETTLE_S = 0.5


def command(*, period_us: int, priority: int, duration_s: int, bins: int) -> list[str]:
    """Return the command line for one block; priority 0: without a real-time policy."""
    program = shutil.which("cyclictest")
    if program is None:
        raise FailedError(
            "cyclictest is not installed: apt-get install rt-tests (Debian, Ubuntu)"
        )
    policy = ["-p", str(priority)] if priority > 0 else ["--policy=other"]
    timing = ["-i", str(period_us), "-D", str(duration_s), "-h", str(bins)]
    return [program, "-q", "-m", "-t", "1", *policy, *timing]


def run(command_line: list[str], duration_s: int) -> NDArray[np.int64]:
    """Run one block and return its histogram in bins of 1 us; the last bin takes the overflow."""
    try:
        done = subprocess.run(  # noqa: S603 - our own command line
            command_line,
            capture_output=True,
            text=True,
            timeout=duration_s + 30,
            check=True,
        )
    except subprocess.CalledProcessError as error:
        reason = (error.stderr.strip() or error.stdout.strip()).splitlines() or [
            "no message"
        ]
        raise FailedError(f"cyclictest failed: {reason[-1]}") from None
    except subprocess.TimeoutExpired:
        raise FailedError(
            f"cyclictest did not end within {duration_s + 30} s"
        ) from None
    return parse(done.stdout, int(command_line[command_line.index("-h") + 1]))


@contextlib.contextmanager
def companion(*, period_us: int, duration_s: int) -> Iterator[None]:
    """Run cyclictest without real-time priority beside a block of `duration_s` [s].

    In the blocks of the reference a second paced thread, that of the subject, runs beside
    cyclictest. This one makes the blocks of the subject equal.
    """
    command_line = command(
        period_us=period_us, priority=0, duration_s=duration_s + 2, bins=1
    )
    options = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL}
    with piped(command_line, name="cyclictest", stop_limit_s=10.0, **options):
        time.sleep(_SETTLE_S)
        yield


def parse(text: str, bins: int) -> NDArray[np.int64]:
    """Return the histogram of cyclictest's output, int64 of shape (bins,)."""
    counts = np.zeros(bins, dtype=np.int64)
    for latency, count in re.findall(r"^(\d{6}) (\d+)", text, flags=re.MULTILINE):
        counts[min(int(latency), bins - 1)] += int(count)
    for overflow in re.findall(
        r"^# Histogram Overflows: (\d+)", text, flags=re.MULTILINE
    ):
        counts[-1] += int(overflow)
    if counts.sum() == 0:
        raise FailedError("cyclictest printed no histogram")
    return counts
