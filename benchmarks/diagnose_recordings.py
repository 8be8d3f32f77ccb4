"""Real recordings: what the diagnosis gains beside simple rivals, on the same held-out blocks."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.baselines import RIVALS, applies
from benchmarks.campaign_rivals import compared
from benchmarks.sindy import library
from hilserver.bench.report import Result
from hilserver.daemon.assembly import assemble
from hilserver.diagnosis.checks import check
from hilserver.diagnosis.engine import judge, silent
from hilserver.diagnosis.regression.stages import prepare_all
from hilserver.measured.data import MeasuredLog
from hilserver.measured.machine import machine
from hilserver.measured.reading import read_measured
from hilserver.plant.parameters import RobotParameters

QUANTITIES: Final = {"position_m": "position", "yaw_rad": "yaw"}
MAIN: Final = "nine terms"


@dataclass(frozen=True)
class Row:
    """Gains of one quantity on one recording.

    Attributes
    ----------
    engine : float
    rivals : mapping of str to float
    ceiling : float
        What a ridge regression on every column of the library reaches.
    """

    name: str
    quantity: str
    engine: float
    rivals: Mapping[str, float]
    ceiling: float

    @property
    def ratio(self) -> float:
        """Gain of the diagnosis by that of the nine terms; above 1 it is ahead."""
        return self.engine / self.rivals[MAIN]


def measure(mapped: Iterable[tuple[str, Sequence[Path]]]) -> list[Result]:
    """Diagnose every recording by itself, print the table, return its figures.

    Parameters
    ----------
    mapped : iterable of (str, sequence of Path)
        A mapping file, or a built-in one by name, and its logs.
    """
    library()
    robot = assemble(None).robot
    rows: list[Row] = []
    print(f"| recording | quantity | diagnosis | {' | '.join(RIVALS)} | all columns | ratio |")
    print("|---" * (len(RIVALS) + 5) + "|")
    for file, mapping in ((file, mapping) for mapping, files in mapped for file in files):
        for row in beside(file.stem, read_measured([file], mapping), robot):
            rows.append(row)
            cells = " | ".join(f"{ratio:.2f}" for ratio in row.rivals.values())
            print(
                f"| {row.name} | {row.quantity} | {row.engine:.2f} | {cells} "
                f"| {row.ceiling:.2f} | {row.ratio:.3f} |",
                flush=True,
            )
    return list(_figures(rows))


def beside(name: str, log: MeasuredLog, robot: RobotParameters) -> Iterator[Row]:
    """Yield what the diagnosis and its rivals gain on one log."""
    findings = judge(log, robot).findings
    own = machine(log, robot)
    prepared, _ = prepare_all(check(log, own).log, own, 1, silent)
    if "pose" not in prepared or not applies(prepared["pose"].problem):
        return
    rivals = compared(prepared["pose"])
    for key, quantity in QUANTITIES.items():
        engine = findings.total_gain.get(key)
        yield Row(
            name,
            quantity,
            1.0 if engine is None else engine.ratio,
            {rival: gain[key] for rival, gain in rivals.items()},
            findings.ceiling.get(key, float("nan")),
        )


def _figures(rows: Sequence[Row]) -> Iterator[Result]:
    for quantity in QUANTITIES.values():
        ratios = {row.name: row.ratio for row in rows if row.quantity == quantity}
        if ratios:
            mean = float(np.exp(np.mean(np.log(list(ratios.values())))))
            reference = f"gain of {MAIN}"
            yield Result(f"{quantity}: geometric mean", mean, "1", 1.0, reference, raw=ratios)
            yield Result(f"{quantity}: worst", min(ratios.values()), "1", 0.9, "bound", raw=ratios)
