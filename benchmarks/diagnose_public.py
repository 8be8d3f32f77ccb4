"""Public recordings: the patch of the diagnosis beside published methods, from the same runs.

Machines that nobody here has seen are `diagnose_unseen`; this is the set of calibration runs. Each
method, and the diagnosis, learns from one set of squares and is judged by all runs of all other
sets: squares, circles and free drives. The metric is that of the authors of the data: the distance
and the heading by which the computed pose is off at the end of a run, from its measured first one.
"""

import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmarks.calibration_methods import METHODS, missed
from benchmarks.calibration_runs import (
    MACHINES,
    Machine,
    read_runs,
    sets_of_squares,
    write_table,
)
from benchmarks.diagnose_results import Results, sources
from benchmarks.diagnose_unseen import measure as unseen
from benchmarks.diagnose_unseen import there
from benchmarks.public_machines import PUBLIC_MACHINES
from hilserver.arrays import Array
from hilserver.bench.report import Result
from hilserver.daemon.assembly import assemble
from hilserver.diagnosis.engine import diagnose
from hilserver.diagnosis.memory import one_blas_thread
from hilserver.diagnosis.regression.gain import missed as missed_by
from hilserver.diagnosis.regression.gain import windows
from hilserver.diagnosis.regression.problem import Problem
from hilserver.diagnosis.regression.stages import stages_of
from hilserver.errors import FailedError
from hilserver.measured.data import MeasuredLog
from hilserver.measured.machine import machine as machine_of
from hilserver.measured.reading import read_measured
from hilserver.program.workers import in_processes

MAPPINGS: Final = Path(__file__).parents[1] / "docs" / "how-to" / "mappings"
OWN: Final = ("diagnose_public", "calibration_methods", "calibration_runs")
CALIBRATION: Final = "sousarbarb/odometry-calibration"
PATCH: Final = "patch of the diagnosis"
PUBLISHED: Final[Mapping[str, Mapping[str, tuple[float, float]]]] = {
    "diff": {
        "UMBmark": (0.0378, 4.66),
        "Jung and Chung": (0.0720, 5.36),
        "OptiOdom": (0.0539, 3.34),
    },
    "omni4": {"Lin et al.": (0.3036, 15.79), "OptiOdom": (0.2901, 16.85)},
}
"""Worst distance [m] and heading [deg] at the end, from data/data.xlsx of the authors.

They are of the runs that a method was fitted to: with UMBmark, Jung and Chung each set of squares
by itself.
"""


@dataclass(frozen=True, slots=True)
class Task:
    """One robot, and the set of squares that is learned from."""

    folder: Path
    machine: Machine
    data_set: str
    jobs: int

    @property
    def key(self) -> str:
        """Its name among all results."""
        return f"{self.machine.name}/{self.data_set}"


def measure(folder: Path, resume: Path, jobs: int) -> list[Result]:
    """Diagnose all public recordings in a folder, print their tables, return the figures.

    Parameters
    ----------
    folder : Path
        Holds clones of public repositories, each called as its repository.
    resume : Path
        Results so far: what is in it is not diagnosed again.

    Raises
    ------
    FailedError
        If none of the repositories is there.
    """
    calibration = folder / CALIBRATION.partition("/")[2]
    figures: list[Result] = []
    if there(folder):
        figures += unseen(folder, resume, jobs)
    if (calibration / "data").is_dir():
        figures += _calibration(calibration, resume, jobs)
    if not figures:
        names = (CALIBRATION, *dict.fromkeys(m.repository for m in PUBLIC_MACHINES))
        msg = f"--public {folder}: clone one of {', '.join(names)} there"
        raise FailedError(msg)
    return figures


def _calibration(folder: Path, resume: Path, jobs: int) -> list[Result]:
    """Diagnose every set of squares of each robot."""
    results = Results(resume, "public", sources(OWN))
    tasks = [
        Task(folder, machine, name, jobs)
        for machine in MACHINES
        for name in sets_of_squares(read_runs(folder, machine))
    ]
    todo = [task for task in tasks if task.key not in results.records]
    try:
        with closing(in_processes(work, todo, 1)) as records:
            for done, (_, record) in enumerate(records, 1):
                results.add(record)
                print(f"{record['key']}: {done} of {len(todo)}", file=sys.stderr)
    finally:
        found = [results.records[t.key] for t in tasks if t.key in results.records]
        figures = list(_report(found))
    return figures


def _report(records: Sequence[Mapping[str, Any]]) -> Iterator[Result]:
    """Print the table of each robot and what was found, and yield the figures."""
    for machine in MACHINES:
        mine = [r for r in records if r["key"].startswith(f"{machine.name}/")]
        if not mine:
            continue
        ends = _ends(mine)
        print("\n".join(_table(machine.name, ends, len(mine))))
        for record in mine:
            patch = record["patch"].items()
            said = ", ".join(f"{term} {value:+.4g}" for term, value in patch)
            print(f"{record['key']}: {said or 'no patch'}")
        yield from _figures(machine.name, ends)


@one_blas_thread
def work(one: Task) -> dict[str, Any]:
    """Return the record of a set: the patch, and by method the errors at the end of other runs."""
    begin = time.perf_counter()
    runs = read_runs(one.folder, one.machine)
    learned = [run for run in runs if run.data_set == one.data_set]
    left_out = [run for run in runs if run.data_set != one.data_set]
    ends = {}
    for name, method in METHODS[one.machine.name].items():
        matrix = method(one.machine, learned)
        off = np.stack([missed(matrix, run) for run in left_out])
        ends[name] = [
            np.hypot(off[:, 0], off[:, 1]).tolist(),
            np.abs(off[:, 2]).tolist(),
        ]

    mapping, logs = str(MAPPINGS / f"{one.machine.mapping}.yaml"), []
    with tempfile.TemporaryDirectory() as place:
        for name, some in (("learned", learned), ("left_out", left_out)):
            table = Path(place) / f"{name}.csv"
            write_table(table, some, one.machine)
            logs.append(read_measured([table], mapping))
    found = diagnose(logs[0], assemble(None), jobs=one.jobs)
    patch = {term.name: term.parameter.value for term in found.evidence.extension}
    ends[PATCH] = [values.tolist() for values in ends_of(logs[1], patch)]

    named = [[finding.verdict, *finding.causes] for finding in found.findings.findings]
    seconds = time.perf_counter() - begin
    return {
        "key": one.key,
        "ends": ends,
        "patch": patch,
        "named": named,
        "seconds": seconds,
    }


def ends_of(log: MeasuredLog, patch: Mapping[str, float]) -> tuple[Array, Array]:
    """Return by how much a patched plant is off at the end of each run [m, rad], shape (runs,)."""
    robot = machine_of(log, assemble(None).robot)
    problem = Problem(stages_of(log, robot)["pose"].uncut())
    whole = windows(problem, np.inf)
    if whole is None:
        msg = "fewer than four runs are left out: clone the whole data"
        raise FailedError(msg)
    predicted = problem.predict(patch, problem.start_poses(patch))
    off = missed_by(problem, predicted, whole)
    return np.abs(off["position_m"]), np.abs(off["yaw_rad"])


def _ends(records: Iterable[Mapping[str, Any]]) -> dict[str, Array]:
    """Return the errors at all ends by method, shape (2, runs) [m, deg]."""
    parts: dict[str, list[Array]] = {}
    for record in records:
        for name, ends in record["ends"].items():
            parts.setdefault(name, []).append(
                np.array(ends) * [[1.0], [np.degrees(1.0)]]
            )
    return {name: np.concatenate(each, axis=1) for name, each in parts.items()}


def _table(name: str, ends: Mapping[str, Array], sets: int) -> Iterator[str]:
    """Yield the lines of one robot's table."""
    runs = next(iter(ends.values())).shape[1]
    yield (
        f"| {name}: {sets} sets learned, {runs} ends of other runs | mean, m | median, m"
        " | worst, m | mean, deg | worst, deg | published, m | published, deg |"
    )
    yield "|---" * 8 + "|"
    for method, (away_m, turned_deg) in ends.items():
        published = PUBLISHED[name].get(method)
        said = (
            ("", "") if published is None else [f"{value:.4g}" for value in published]
        )
        yield (
            f"| {method} | {away_m.mean():.4f} | {np.median(away_m):.4f} | {away_m.max():.4f}"
            f" | {turned_deg.mean():.2f} | {turned_deg.max():.2f} | {' | '.join(said)} |"
        )
    yield ""


def _figures(name: str, ends: Mapping[str, Array]) -> Iterator[Result]:
    rivals: Sequence[str] = [method for method in ends if method != PATCH]
    for row, (quantity, unit) in enumerate((("distance", "m"), ("heading", "deg"))):
        means = {method: float(each[row].mean()) for method, each in ends.items()}
        best = min(rivals, key=means.__getitem__)
        yield Result(
            f"{name}: mean {quantity} at the end",
            means[PATCH],
            unit,
            means[best],
            best,
            means[best] / means[PATCH],
            raw={method: each[row].tolist() for method, each in ends.items()},
        )
