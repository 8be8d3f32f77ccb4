"""Cost of a sweep: machines per minute, the overhead of Dask on the same cores, memory.

A machine drives 60 s with a 1 kHz plant and its sensors. Rates count once all workers are warm.
Blocks on processes and on a Dask cluster with as many workers alternate, and both stay alive. With
--truth, sweeps with known truth run instead, one line of JSON each.
"""

import argparse
import itertools
import json
import os
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.dask_cluster import cluster
from hilserver.bench.report import Result
from hilserver.commands.options import out_file
from hilserver.errors import FailedError
from hilserver.program.children import piped, python
from hilserver.sweep.campaign import (
    IN_A_BATCH,
    DaskWorkers,
    LocalWorkers,
    Workers,
    outcomes,
)
from hilserver.sweep.estimates import LEAST_MACHINES, median_interval
from hilserver.sweep.prepare import PreparedSweep, prepare

COMPILED_A_MINUTE, PYTHON_A_MINUTE, MOST_MB, DASK = 3000.0, 600.0, 1000.0, 1.10
"""Required figures."""
DRIVE_S, SHORT_S = 60.0, 0.2
SAMPLE_S: Final = 0.2
CONTROLLER = """
from hilserver.plant.blocks import Output, block

@block(inputs=("x_m", "yaw_rad"), outputs=(Output("v"), Output("w")), parameters={"gain": 2.0})
def follow(dt_s, u, y, x, p):
    y[0] = max(-0.3, min(0.3, p[0] * (5.0 - u[0])))
    y[1] = max(-1.0, min(1.0, -2.0 * u[1]))

class Controller:
    def __call__(self, time_s, signals):
        v = max(-0.3, min(0.3, 2.0 * (5.0 - signals["pose.x_m"])))
        w = max(-1.0, min(1.0, -2.0 * signals["pose.yaw_rad"]))
        return {"control.mode": 1, "twist.linear_m_s": v, "twist.angular_rad_s": w}
"""
KINDS: dict[str, Any] = {
    "compiled": {
        "block": "controller.py:follow",
        "inputs": {"x_m": "pose.x_m", "yaw_rad": "pose.yaw_rad"},
        "drives": {"v": "twist.linear_m_s", "w": "twist.angular_rad_s"},
    },
    "python": {"python": "controller.py:Controller", "every_ms": 20},
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, metavar="N")
    parser.add_argument(
        "--blocks", type=int, default=20, help="of each kind of workers (20)"
    )
    parser.add_argument("--machines", type=int, default=200, help="of a block (200)")
    parser.add_argument(
        "--most", type=int, default=10_000, help="machines of the memory's row"
    )
    parser.add_argument(
        "--truth",
        type=out_file,
        metavar="FILE",
        help="sweep known truths, a line of JSON each",
    )


def run(args: argparse.Namespace) -> list[Result]:
    """Measure rates, Dask and memory, or known truths.

    Raises
    ------
    FailedError
        If Dask is not installed, or a machine cannot be driven.
    """
    if args.truth is not None:
        return _truths(args.truth)
    with tempfile.TemporaryDirectory(prefix="hilserver-sweep-") as name:
        folder = Path(name)
        (folder / "controller.py").write_text(CONTROLLER, encoding="utf-8")
        text = "steps: [{at_s: 0.0, write: {control.mode: 1}}]"
        (folder / "course.yaml").write_text(text, encoding="utf-8")
        return [*_rates(folder, args), *_memory(folder, args)]


def _sweep(folder: Path, kind: str, machines: int, duration_s: float) -> Path:
    path = folder / f"{kind}-{machines}.yaml"
    sweep = {
        "machines": machines,
        "from": {
            "population": {
                "coulomb_friction": {"uniform": [0, 5]},
                "wheel_radius_difference": {"sd": 0.01},
            }
        },
        "drive": {"scenario": "course.yaml", "duration_s": duration_s},
        "controller": KINDS[kind],
        "require": [
            {
                "name": "arrives",
                "signal": "pose.x_m",
                "above": 4.9,
                "within_s": 0.8 * duration_s,
            },
            {"name": "straight", "signal": "pose.y_m", "below": 0.1, "above": -0.1},
        ],
    }
    path.write_text(json.dumps(sweep), encoding="utf-8")
    return path


# --- machines a minute ----------------------------------------------------------------------------


def _rates(folder: Path, args: argparse.Namespace) -> Iterator[Result]:
    n = args.machines
    compiled, interpreted = (
        prepare(_sweep(folder, kind, n, DRIVE_S)) for kind in KINDS
    )
    with LocalWorkers(args.workers, 1000.0) as local:
        slow = [
            _a_minute(interpreted, local, args.workers)
            for _ in range(max(args.blocks // 4, 1))
        ]
        with cluster(args.workers) as address, DaskWorkers(address) as remote:
            pools: list[Workers] = [local, remote]
            pairs = [
                [_a_minute(compiled, pool, args.workers) for pool in pools]
                for _ in range(args.blocks)
            ]
    fast = [pair[0] for pair in pairs]
    ratios = np.array([pair[0] / pair[1] for pair in pairs])
    for kind, rates, wanted in (
        ("compiled", fast, COMPILED_A_MINUTE),
        ("python", slow, PYTHON_A_MINUTE),
    ):
        value = statistics.median(rates)
        yield Result(
            f"sweep_{kind}_a_minute",
            value,
            "1/min",
            wanted,
            "required",
            value / wanted,
            rates,
        )
    median, low, high = statistics.median(ratios.tolist()), float("nan"), float("nan")
    if len(ratios) >= LEAST_MACHINES:
        median, low, high = median_interval(ratios)
    text = f"required; {low:.3f} .. {high:.3f}"
    yield Result("sweep_dask_overhead", median, "1", DASK, text, median / DASK, pairs)


def _a_minute(prepared: PreparedSweep, workers: Workers, count: int) -> float:
    """Return machines per minute, once each worker has driven a batch."""
    first, n, done, began_s = 2 * count * IN_A_BATCH, prepared.sweep.machines, 0, 0.0
    counted = 0
    for _, batch in outcomes(
        prepared.job, map(prepared.machine, range(n + first)), workers
    ):
        if any(outcome.error for outcome in batch):
            raise FailedError(f"a machine failed: {batch[0].error}")
        done += len(batch)
        if done > first and began_s:
            counted += len(batch)
        elif done >= first:
            began_s = time.monotonic()
    return 60.0 * counted / (time.monotonic() - began_s)


# --- memory ---------------------------------------------------------------------------------------


def _memory(folder: Path, args: argparse.Namespace) -> Iterator[Result]:
    few, many = max(args.most // 10, 10), args.most
    peaks = {
        n: _peak_mb(_sweep(folder, "compiled", n, SHORT_S), args.workers)
        for n in (few, many)
    }
    peak = peaks[many]
    yield Result(
        "sweep_memory_mb", peak, "MB", MOST_MB, "required", peak / MOST_MB, peaks
    )
    text = f"of {few} machines"
    yield Result("sweep_memory_growth", peak, "MB", peaks[few], text, peak / peaks[few])


def _peak_mb(path: Path, workers: int) -> float:
    """Return the peak memory of a whole sweep, all its processes together."""
    out = path.with_suffix("")
    command = python(
        "-m", "hilserver", "sweep", str(path), "-o", str(out), "--workers", str(workers)
    )
    peak = 0.0
    with piped(
        command, name="hilserver sweep", stdin=None, stdout=sys.stderr
    ) as process:
        while process.poll() is None:
            peak = max(peak, sum(map(_mb, _family(process.pid))))
            time.sleep(SAMPLE_S)
    if process.returncode != 0:
        raise FailedError(
            f"the sweep of {path} ended with exit code {process.returncode}"
        )
    return peak


def _family(pid: int) -> list[int]:
    """Return a process and all that it has started."""
    try:
        text = Path(f"/proc/{pid}/task/{pid}/children").read_text(encoding="ascii")
    except OSError:
        return []
    return [
        pid,
        *itertools.chain.from_iterable(_family(int(child)) for child in text.split()),
    ]


def _mb(pid: int) -> float:
    """Return the memory of a process; shared memory counts in proportion."""
    try:
        text = Path(f"/proc/{pid}/smaps_rollup").read_text(encoding="ascii")
    except OSError:
        return 0.0
    rows = (line.split() for line in text.splitlines() if line.startswith("Pss:"))
    return sum(float(row[1]) for row in rows) / 1024.0


def _truths(path: Path) -> list[Result]:
    from benchmarks import sweep_truth  # noqa: PLC0415 - only here

    results = []
    with path.open("w", encoding="utf-8") as file:
        for line in sweep_truth.lines():
            file.write(json.dumps(line) + "\n")
            file.flush()
            value = float(line["share"] if "share" in line else line["held"])
            results.append(
                Result(line["truth"], value, "1", line.get("share_true"), raw=line)
            )
    return results
