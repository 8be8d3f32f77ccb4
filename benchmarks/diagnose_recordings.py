"""Real recordings: what the diagnosis gains beside simple rivals, on the same held-out blocks.

Selection of causes is repeated without each half of the blocks, as in every diagnosis.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from benchmarks.baselines import RIVALS, applies
from benchmarks.sindy import library
from hilserver.bench.report import Result
from hilserver.daemon.assembly import assemble
from hilserver.diagnosis.checks import check
from hilserver.diagnosis.engine import HORIZON_S
from hilserver.diagnosis.examine import examine
from hilserver.diagnosis.findings.nested import cross_validated, judged_by_halves
from hilserver.diagnosis.progress import Tracker
from hilserver.diagnosis.regression.gain import gains
from hilserver.diagnosis.regression.stages import prepare_all
from hilserver.diagnosis.schema.findings import Gain
from hilserver.measured.data import MeasuredLog
from hilserver.measured.machine import machine
from hilserver.measured.reading import read_measured
from hilserver.plant.parameters import RobotParameters

QUANTITIES: Final = {"position_m": "position", "yaw_rad": "yaw"}
NINE_TERMS: Final = ("nine terms", "nine terms, end errors")
"""The one of the larger geometric mean is the bar, quantity by quantity."""


@dataclass(frozen=True)
class Row:
    """Gains of one quantity on one recording.

    Attributes
    ----------
    engine : float
    ahead : mapping of str to Gain
        Error of each rival by that of the diagnosis; its interval is of pairs, block by block.
    """

    name: str
    quantity: str
    engine: float
    ahead: Mapping[str, Gain]

    def gain(self, rival: str) -> float:
        """Return what a rival gains."""
        return self.engine / self.ahead[rival].ratio


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
    beyond = " | ".join(f"by {rival}" for rival in NINE_TERMS)
    print(f"| recording | quantity | diagnosis | {' | '.join(RIVALS)} | {beyond} |")
    print("|---" * (len(RIVALS) + len(NINE_TERMS) + 3) + "|")
    for file, mapping in ((file, mapping) for mapping, files in mapped for file in files):
        for row in against_rivals(file.stem, read_measured([file], mapping), robot):
            rows.append(row)
            cells = [f"{row.gain(rival):.2f}" for rival in RIVALS]
            for gain in (row.ahead[rival] for rival in NINE_TERMS):
                low, high = gain.ci95 or (float("nan"), float("nan"))
                cells.append(f"{gain.ratio:.3f} ({low:.2f} to {high:.2f})")
            print(
                f"| {row.name} | {row.quantity} | {row.engine:.2f} | {' | '.join(cells)} |",
                flush=True,
            )
    return list(_figures(rows))


def against_rivals(name: str, log: MeasuredLog, robot: RobotParameters) -> Iterator[Row]:
    """Yield what the diagnosis and its rivals gain on one log."""
    rng = np.random.default_rng(0)
    judged = examine(log, robot, rng, 1, Tracker()).judged
    own = machine(log, robot)
    prepared, _ = prepare_all(check(log, own).log, own, 1, Tracker())
    if "pose" not in judged or not applies(prepared["pose"].problem):
        return
    problem, before = prepared["pose"].problem, prepared["pose"].base.predicted
    halves = judged_by_halves(judged, 0, 1).get("pose", ())
    after = cross_validated(judged["pose"], halves, before).parts[0].after if halves else before
    engine = gains(problem, before, after, HORIZON_S, rng)
    ahead = {
        rival: gains(problem, predict(prepared["pose"]), after, HORIZON_S, rng)
        for rival, predict in RIVALS.items()
    }
    for key, quantity in QUANTITIES.items():
        yield Row(name, quantity, engine[key].ratio, {r: gain[key] for r, gain in ahead.items()})


def _figures(rows: Sequence[Row]) -> Iterator[Result]:
    for quantity in QUANTITIES.values():
        mine = [row for row in rows if row.quantity == quantity]
        if not mine:
            continue
        bar = max(NINE_TERMS, key=lambda rival: _mean([row.gain(rival) for row in mine]))
        ratios = {row.name: row.ahead[bar].ratio for row in mine}
        mean, reference = _mean(list(ratios.values())), f"gain of {bar}"
        yield Result(f"{quantity}: geometric mean", mean, "1", 1.0, reference, raw=ratios)
        yield Result(f"{quantity}: worst", min(ratios.values()), "1", 0.85, "bound", raw=ratios)


def _mean(values: Sequence[float]) -> float:
    return float(np.exp(np.mean(np.log(values))))
