"""Machines of public repositories: the patch of one drive on the other, beside least squares.

The rival is what an engineer would fit by hand: radius, turn, one delay and the axis of the
reference, by the errors at the end of free runs, which is also the measure of both. Both predict
from the raw drive, with its time stamps as they are.
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
from scipy.optimize import least_squares

from benchmarks.diagnose_results import Results, sources
from benchmarks.public_machines import (
    PUBLIC_MACHINES,
    PublicMachine,
    commit,
    write_columns,
)
from hilserver.arrays import Array
from hilserver.bench.report import Result
from hilserver.daemon.assembly import assemble
from hilserver.diagnosis.catalogue.vocabulary import OF_THE_LOG
from hilserver.diagnosis.decide import one_topic
from hilserver.diagnosis.engine import diagnose
from hilserver.diagnosis.memory import one_blas_thread
from hilserver.diagnosis.regression.gain import HORIZON_S, errors, missed, windows
from hilserver.diagnosis.regression.problem import Problem
from hilserver.diagnosis.regression.stages import stages_of
from hilserver.diagnosis.schema.evidence import Diagnosis
from hilserver.measured.data import MeasuredLog
from hilserver.measured.machine import machine
from hilserver.measured.reading import read_measured
from hilserver.program.workers import in_processes

OWN: Final = ("diagnose_unseen", "public_machines")
QUANTITIES: Final = {
    "position_m": "position", "yaw_rad": "heading", "gyro_z_rad_s": "turn rate"
}  # fmt: skip
POSE_TERMS: Final = ("wheel_radius", "rotation_gain", "nav_frame_yaw", "shift.nav")
GYRO_TERMS: Final = ("rotation_gain", "imu_latency")
LATE_S: Final = (0.0, 0.2)  # delays from which the search begins
MOST_RUNS: Final = 30


@dataclass(frozen=True, slots=True)
class Pair:
    """A machine, one drive that is learned from, and the other one that judges."""

    folder: Path
    machine: PublicMachine
    learned: int
    jobs: int

    @property
    def key(self) -> str:
        """Its name among all results."""
        return f"{self.machine.name}/{self.learned}"


def there(folder: Path) -> list[PublicMachine]:
    """Return the machines whose repositories are in a folder of clones."""
    return [one for one in PUBLIC_MACHINES if one.clone(folder).is_dir()]


def measure(folder: Path, resume: Path, jobs: int) -> list[Result]:
    """Diagnose both drives of each machine in a folder, print the table, return its figures."""
    results = Results(resume, "unseen", sources(OWN))
    pairs = [Pair(folder, one, k, jobs) for one in there(folder) for k in range(2)]
    todo = [pair for pair in pairs if pair.key not in results.records]
    try:
        with closing(in_processes(work, todo, 1)) as records:
            for done, (_, record) in enumerate(records, 1):
                results.add(record)
                print(f"{record['key']}: {done} of {len(todo)}", file=sys.stderr)
    finally:
        found = [results.records[p.key] for p in pairs if p.key in results.records]
        print("\n".join(_table(found)))
    return list(_figures(found))


@one_blas_thread
def work(pair: Pair) -> dict[str, Any]:
    """Return the record of a pair: what is found, and errors on the other drive by quantity."""
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as place:
        mapping = Path(place) / "mapping.yaml"
        mapping.write_text(pair.machine.mapping(), encoding="utf-8")
        logs = []
        for number, drive in enumerate(pair.machine.read(pair.folder)):
            table = Path(place) / f"drive_{number}.csv"
            write_columns(table, drive)
            logs.append(read_measured([table], str(mapping)))
    learned, other = logs[pair.learned], logs[1 - pair.learned]
    found = diagnose(learned, assemble(None), jobs=pair.jobs)
    known, judge = (_problem(log) for log in (learned, other))
    by_hand, terms = plain_least_squares(known), terms_of(found)
    # no patch corrects the stamps of a log: its gain, the headline, is that beside corrected ones
    of_log = {name: value for name, value in terms.items() if name in OF_THE_LOG}
    means = {
        how: mean_errors(judge, model)
        for how, model in (
            ("configured", {}),
            ("corrected", of_log),
            ("patch", terms),
            ("least squares", by_hand),
        )
    }
    headline = {name: list(gain.ci95) for name, gain in found.findings.total_gain.items()
                if gain.ci95 is not None}  # fmt: skip
    return {
        "key": pair.key,
        "machine": pair.machine.name,
        "source": f"{pair.machine.repository}@{commit(pair.machine.clone(pair.folder))}",
        "findings": [[f.verdict, *f.causes] for f in found.findings.findings],
        "terms": terms,
        "by_hand": by_hand,
        "means": means,
        "headline": headline,
        "seconds": time.perf_counter() - begin,
    }


def terms_of(found: Diagnosis) -> dict[str, float]:
    """Return what a diagnosis would change: the patch, and what corrects the log."""
    terms = {term.name: term.parameter.value for term in found.evidence.extension}
    for finding in found.findings.findings:
        for term, parameter in OF_THE_LOG.items():
            if parameter in finding.parameters and finding.verdict != "data_fault":
                terms[term] = finding.parameters[parameter].value
    return terms


def plain_least_squares(problem: Problem) -> dict[str, float]:
    """Return radius, turn, delay and axis of the reference that a drive shows at its free runs.

    Absolute errors count where they are large, so that few wild samples do not decide.
    """
    runs = windows(problem, HORIZON_S)
    names = POSE_TERMS if runs is not None else GYRO_TERMS
    scales: dict[str, float] = {}

    def off(theta: Array) -> Array:
        terms = dict(zip(names, theta, strict=True))
        predicted = problem.predict(terms, problem.start_poses(terms))
        if runs is None:
            parts = {"rate": problem.residual(predicted) + 0j}
        else:
            parts = dict(missed(problem, predicted, runs))
        for key, part in parts.items():
            scales.setdefault(key, float(np.median(np.abs(part))) + 1e-9)
        return np.concatenate(
            [np.concatenate([p.real, p.imag]) / scales[key] for key, p in parts.items()]
        )

    fits = [
        least_squares(
            off,
            [0.0] * (len(names) - 1) + [late_s],
            loss="soft_l1",
            diff_step=1e-3,
            x_scale=0.1,
            max_nfev=MOST_RUNS,
        )
        for late_s in LATE_S
    ]
    best = min(fits, key=lambda fit: float(fit.cost))
    return dict(zip(names, best.x.tolist(), strict=True))


def mean_errors(problem: Problem, terms: Mapping[str, float]) -> dict[str, float]:
    """Return the mean error of each quantity: at the end of free runs, of a gyro in all samples."""
    predicted = problem.predict(terms, problem.start_poses(terms))
    pairs = errors(problem, (predicted, predicted), HORIZON_S)
    return {name: float(pair.after.values.mean()) for name, pair in pairs.items()}


def _problem(log: MeasuredLog) -> Problem:
    robot = machine(log, assemble(None).robot)
    checked = one_topic.checked(log, robot).log
    return Problem(stages_of(checked, robot)["pose"].uncut())


def _rows(records: Iterable[Mapping[str, Any]]) -> Iterator[tuple[Any, ...]]:
    """Yield record, quantity, gain beside least squares, gain and interval of the headline."""
    for record in records:
        means = record["means"]
        for name in means["patch"]:
            error = means["patch"][name]
            yield (
                record,
                name,
                means["least squares"][name] / error,
                means["corrected"][name] / error,
                record["headline"].get(name),
            )


def _table(records: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    yield (
        "| machine | source | drive | quantity | configured | least squares | patch"
        " | beside least squares | gain | headline |"
    )
    yield "|---" * 10 + "|"
    for record, name, beside, gain, headline in _rows(records):
        means = record["means"]
        cells = [
            f"{means[how][name]:.4f}"
            for how in ("configured", "least squares", "patch")
        ]
        said = "none" if headline is None else f"{headline[0]:.2f} to {headline[1]:.2f}"
        drive = int(record["key"].rpartition("/")[2]) + 1
        yield (
            f"| {record['machine']} | {record['source']} | {drive} | {QUANTITIES[name]}"
            f" | {' | '.join(cells)} | {beside:.2f} | {gain:.2f} | {said} |"
        )
    yield ""
    for record in records:
        said = "; ".join(": ".join((v, ", ".join(c))) for v, *c in record["findings"])
        yield f"{record['key']}: {said or 'nothing'}"
    yield ""


def _figures(records: Sequence[Mapping[str, Any]]) -> Iterator[Result]:
    rows = list(_rows(records))
    for name, quantity in QUANTITIES.items():
        beside = {row[0]["key"]: row[2] for row in rows if row[1] == name}
        if beside:
            mean = float(np.exp(np.mean(np.log(list(beside.values())))))
            reference = "error of least squares"
            yield Result(
                f"{quantity}: geometric mean", mean, "1", 1.0, reference, raw=beside
            )
            yield Result(
                f"{quantity}: worst",
                min(beside.values()),
                "1",
                1.0,
                reference,
                raw=beside,
            )
    said = [(gain, *headline) for *_, gain, headline in rows if headline is not None]
    if said:
        inside = [low <= gain <= high for gain, low, high in said]
        width = float(np.median([high / low for _, low, high in said]))
        yield Result(
            "headlines whose interval holds the gain", float(np.mean(inside)), "1"
        )
        yield Result("headlines: width of the interval", width, "1")
