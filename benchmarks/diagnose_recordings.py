"""Real recordings: gains of the diagnosis and of simple rivals, on the same held-out blocks.

Selection of causes is repeated without each half of the blocks, as in every diagnosis. Results are
appended to a file as they come: an interrupted run continues where it stopped.
"""

import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from pydantic import BaseModel, ConfigDict

from benchmarks.baselines import RIVALS, applies
from benchmarks.diagnose_results import Results, sources
from benchmarks.sindy import library
from hilserver.bench.report import Result
from hilserver.daemon.assembly import assemble
from hilserver.diagnosis.checks import check
from hilserver.diagnosis.examine import examine
from hilserver.diagnosis.findings.nested import cross_validated, judged_by_halves
from hilserver.diagnosis.memory import one_blas_thread
from hilserver.diagnosis.progress import Tracker
from hilserver.diagnosis.regression.gain import HORIZON_S, gains
from hilserver.diagnosis.regression.stages import prepare_all
from hilserver.diagnosis.schema.findings import Gain
from hilserver.measured.data import MeasuredLog
from hilserver.measured.machine import machine
from hilserver.measured.reading import read_measured
from hilserver.plant.parameters import RobotParameters
from hilserver.program.workers import in_processes

QUANTITIES: Final = {"position_m": "position", "yaw_rad": "yaw"}
NINE_TERMS: Final = ("nine terms", "nine terms, end errors")
"""The one with the larger geometric mean is the bar, for each quantity."""
OWN: Final = ("diagnose_recordings", "baselines", "sindy", "gaussian_process")
"""Modules here on which a result depends, in addition to the engine."""


class Row(BaseModel):
    """Gains of one quantity on one recording.

    Attributes
    ----------
    engine : float
    ahead : mapping of str to Gain
        Error of each rival divided by that of the diagnosis; its interval is from pairs of blocks.
    """

    model_config = ConfigDict(frozen=True)

    name: str
    quantity: str
    engine: float
    ahead: Mapping[str, Gain]

    def gain(self, rival: str) -> float:
        """Return the gain of a rival."""
        return self.engine / self.ahead[rival].ratio


@dataclass(frozen=True, slots=True)
class Recording:
    """A file and its mapping: a file too, or the name of a built-in one."""

    mapping: str
    file: Path

    @property
    def key(self) -> str:
        """Its name among all results."""
        return f"{self.mapping}={self.file}"


def measure(
    mapped: Iterable[tuple[str, Sequence[Path]]], resume: Path, jobs: int
) -> list[Result]:
    """Diagnose every recording by itself, print the table, return its figures.

    Parameters
    ----------
    mapped : iterable of (str, sequence of Path)
        A mapping, and its logs.
    resume : Path
        Results so far: recordings in it are not measured again.
    jobs : int
        Worker processes.
    """
    library()
    asked = [Recording(mapping, file) for mapping, files in mapped for file in files]
    results = Results(resume, "recordings", sources(OWN))
    todo = [one for one in asked if one.key not in results.records]
    try:
        with closing(in_processes(work, todo, jobs)) as records:
            for done, (_, record) in enumerate(records, 1):
                results.add(record)
                print(f"{record['key']}: {done} of {len(todo)}", file=sys.stderr)
    finally:
        found = [
            results.records[one.key] for one in asked if one.key in results.records
        ]
        rows = [Row.model_validate(row) for record in found for row in record["rows"]]
        print(_table(rows))
    return list(_figures(rows))


@one_blas_thread
def work(one: Recording) -> dict[str, Any]:
    """Return the record of one recording: a line of the file of results."""
    begin = time.perf_counter()
    rows = against_rivals(
        one.file.stem, read_measured([one.file], one.mapping), _robot()
    )
    plain = [row.model_dump(mode="json") for row in rows]
    return {"key": one.key, "rows": plain, "seconds": time.perf_counter() - begin}


@cache
def _robot() -> RobotParameters:
    return assemble(None).robot


def _table(rows: Sequence[Row]) -> str:
    beyond = " | ".join(f"by {rival}" for rival in NINE_TERMS)
    lines = [
        f"| recording | quantity | diagnosis | {' | '.join(RIVALS)} | {beyond} |",
        "|---" * (len(RIVALS) + len(NINE_TERMS) + 3) + "|",
    ]
    for row in rows:
        cells = [f"{row.gain(rival):.2f}" for rival in RIVALS]
        for gain in (row.ahead[rival] for rival in NINE_TERMS):
            low, high = gain.ci95 or (float("nan"), float("nan"))
            cells.append(f"{gain.ratio:.3f} ({low:.2f} to {high:.2f})")
        lines.append(
            f"| {row.name} | {row.quantity} | {row.engine:.2f} | {' | '.join(cells)} |"
        )
    return "\n".join(lines)


def against_rivals(
    name: str, log: MeasuredLog, robot: RobotParameters
) -> Iterator[Row]:
    """Yield the gains of the diagnosis and its rivals on one log."""
    rng = np.random.default_rng(0)
    judged = examine(log, robot, rng, 1, Tracker()).judged
    own = machine(log, robot)
    prepared, _ = prepare_all(check(log, own).log, own, 1, Tracker())
    if "pose" not in judged or not applies(prepared["pose"].problem):
        return
    problem, before = prepared["pose"].problem, prepared["pose"].base.predicted
    halves = judged_by_halves(judged, 0, 1).get("pose", ())
    after = (
        cross_validated(judged["pose"], halves, before).parts[0].after
        if halves
        else before
    )
    engine = gains(problem, before, after, HORIZON_S, rng)
    ahead = {
        rival: gains(problem, predict(prepared["pose"]), after, HORIZON_S, rng)
        for rival, predict in RIVALS.items()
    }
    for key, quantity in QUANTITIES.items():
        beside = {rival: gain[key] for rival, gain in ahead.items()}
        yield Row(name=name, quantity=quantity, engine=engine[key].ratio, ahead=beside)


def _figures(rows: Sequence[Row]) -> Iterator[Result]:
    for quantity in QUANTITIES.values():
        mine = [row for row in rows if row.quantity == quantity]
        if not mine:
            continue
        bar = max(
            NINE_TERMS, key=lambda rival: _mean([row.gain(rival) for row in mine])
        )
        ratios = {row.name: row.ahead[bar].ratio for row in mine}
        mean, reference = _mean(list(ratios.values())), f"gain of {bar}"
        yield Result(
            f"{quantity}: geometric mean", mean, "1", 1.0, reference, raw=ratios
        )
        yield Result(
            f"{quantity}: worst", min(ratios.values()), "1", 0.85, "bound", raw=ratios
        )


def _mean(values: Sequence[float]) -> float:
    return float(np.exp(np.mean(np.log(values))))
