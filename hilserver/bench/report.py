"""The format in which measured figures are printed and written: schema ``hilserver.bench/1``.

Latencies come as linear histograms in bins of 1 us, as cyclictest prints them.
"""

import json
import os
import platform
import time
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilserver import __version__

SCHEMA = "hilserver.bench/1"


@dataclass(frozen=True)
class Result:
    """One figure with its reference from the same run."""

    name: str
    value: float
    unit: str
    # the same figure of the reference program, in the same unit
    reference: float | None = None
    reference_name: str | None = None
    ratio: float | None = None
    raw: Any = None  # histograms, blocks, command lines: the data behind the figure


_LOOP = "s = 0\nfor i in range(10**6): s += i"
_TIMES = 3


def loop_s() -> float:
    """Return how long ``for i in range(10**7): s += i`` takes in a script [s]: Python's speed here.

    In CPU time, and the best of three goes at a tenth of it: others on the computer hardly count.
    """
    code = compile(_LOOP, "loop", "exec")
    found = []
    for _ in range(_TIMES):
        begun_s = time.thread_time()
        exec(code, {})  # noqa: S102 - names of a script are global, which makes them slower
        found.append(time.thread_time() - begun_s)
    return 10.0 * min(found)


def machine() -> dict[str, Any]:
    """Describe the machine well enough to interpret a figure, without identifying names."""
    model = platform.processor() or "unknown"
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        if line.startswith("model name"):
            model = line.split(":", 1)[1].strip()
            break
    return {
        "cpu": model,
        "cores": os.cpu_count(),
        "kernel": platform.release(),
        "python": platform.python_version(),
        "hilserver": __version__,
        "loop_s": round(loop_s(), 2),
    }


def as_json(results: Iterable[Result]) -> str:
    """Return the results with the machine they were measured on."""
    document = {
        "schema": SCHEMA,
        "machine": machine(),
        "results": [asdict(result) for result in results],
    }
    return json.dumps(document, indent=1) + "\n"


def as_table(results: Iterable[Result]) -> str:
    """Return the results as lines of a table for the terminal."""
    lines = [
        f"{'figure':34} {'value':>12} {'unit':6} {'reference':>12} {'ratio':>7}  reference is"
    ]
    for r in results:
        reference = "" if r.reference is None else f"{r.reference:.4g}"
        ratio = "" if r.ratio is None else f"{r.ratio:.2f}"
        name = r.reference_name or ""
        lines.append(
            f"{r.name:34} {r.value:12.4g} {r.unit:6} {reference:>12} {ratio:>7}  {name}".rstrip()
        )
    lines.append(
        f"speed of this computer: 10**7 additions in a Python loop take {loop_s():.2f} s"
    )
    return "\n".join(lines)


PERCENTILES = (50.0, 99.0, 99.9)


def percentile_us(counts: NDArray[np.int64], percent: float) -> float:
    """Return the smallest latency [us] that `percent` % of the samples do not exceed.

    Bin i holds latencies of i to i + 1 us, the last bin longer ones, too. NaN without samples.
    """
    total = int(counts.sum())
    if total == 0:
        return float("nan")
    rank = -(-total * round(percent * 1000) // 100_000)  # rounded up, in integers
    return float(np.searchsorted(np.cumsum(counts), max(rank, 1)))


def median_of_blocks_us(blocks: Sequence[NDArray[np.int64]], percent: float) -> float:
    """Return the median over the blocks of each block's percentile [us]."""
    return float(np.median([percentile_us(block, percent) for block in blocks]))


def ratio_interval(
    blocks: Sequence[NDArray[np.int64]],
    reference: Sequence[NDArray[np.int64]],
    percent: float,
) -> tuple[float, float]:
    """Return the 95 % interval of the ratio of the medians over the blocks.

    Percentile bootstrap over the blocks (2000 draws, fixed seed): how far the ratio would move if
    the same computer were measured again. A wide interval means the tail is the computer's.
    """
    ours = np.array([percentile_us(block, percent) for block in blocks])
    theirs = np.array([percentile_us(block, percent) for block in reference])
    rng = np.random.default_rng(0)
    draws = 2000
    medians = np.median(ours[rng.integers(len(ours), size=(draws, len(ours)))], axis=1)
    others = np.median(
        theirs[rng.integers(len(theirs), size=(draws, len(theirs)))], axis=1
    )
    low, high = np.percentile(medians / np.maximum(others, 1.0), [2.5, 97.5])
    return float(low), float(high)


def sparse(counts: NDArray[np.int64]) -> dict[str, int]:
    """Return the bins that are not empty: latency [us] -> count."""
    return {str(i): int(counts[i]) for i in np.flatnonzero(counts)}
