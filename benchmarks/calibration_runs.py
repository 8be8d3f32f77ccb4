"""The public runs of sousarbarb/odometry-calibration: wheel ticks beside motion capture.

R. B. Sousa, M. R. Petry, P. G. Costa, A. P. Moreira: OptiOdom, a generic approach for odometry
calibration of wheeled mobile robots, Journal of Intelligent and Robotic Systems 105, 39 (2022).
"""

import csv
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from hilserver.arrays import Array
from hilserver.errors import FailedError

FEWEST_RUNS: Final = 4  # of a set that is learned from: two in each direction
FASTEST_HZ: Final = 25.0
"""Runs are diagnosed at this rate or lower: their wheels' ticks are added up."""


@dataclass(frozen=True)
class Machine:
    """One robot: what is configured, and how a table of its runs is mapped."""

    name: str  # as its folder is called
    mapping: str  # in docs/how-to/mappings
    wheel_diameter_m: float
    # track width, or wheelbase plus track of the robot with rollers
    width_m: float
    columns: tuple[str, ...]  # of the mapping, in the order of the ticks


DIFFERENTIAL: Final = Machine(
    "diff", "diffdrive", 0.084, 0.2, ("right_rad_s", "left_rad_s")
)
ROLLERS: Final = Machine(
    "omni4", "omni4", 0.06, 0.4, tuple(f"w{wheel}_rad_s" for wheel in (1, 2, 3, 4))
)
MACHINES: Final = (DIFFERENTIAL, ROLLERS)


@dataclass(frozen=True)
class Run:
    """One drive, from rest to rest.

    Attributes
    ----------
    data_set : str
        What it was recorded with, as ``square/230620202042``.
    side_m : float
        Of the square that was driven, or NaN.
    clockwise : bool
        Whether it is among the first half of its set, which the authors drove clockwise.
    t_s : ndarray, shape (n,)
    pose : ndarray, shape (n, 3)
        x [m], y [m] and heading [rad] as the cameras saw them.
    turned_rad : ndarray, shape (n, wheels)
        What each wheel turned since the row before.
    """

    data_set: str
    side_m: float
    clockwise: bool
    t_s: Array
    pose: Array
    turned_rad: Array


def read_runs(folder: Path, machine: Machine) -> list[Run]:
    """Return all runs of one robot; FailedError if a file is not as the authors describe it."""
    files = sorted((folder / "data" / machine.name).glob("*/*/*_metadata.csv"))
    return [run for file in files for run in _of_data_set(file)]


def _of_data_set(file: Path) -> list[Run]:
    try:
        with file.open(encoding="utf-8-sig") as opened:
            said = {row[0].strip(): row[1:] for row in csv.reader(opened) if row}
        per_turn = float(said["ngear"][0]) * float(said["encRes"][0])
        side_m = float(said["L"][0] or "nan")
        half = int(said["N"][0]) // 2
        runs = []
        for number in range(1, int(said["N"][0]) + 1):
            named = file.name.replace("_metadata", f"_run-{number:02d}")
            table = np.loadtxt(file.with_name(named), delimiter=",", ndmin=2)
            runs.append(
                Run(
                    f"{file.parent.parent.name}/{file.parent.name}",
                    side_m,
                    number <= half,
                    table[:, 0],
                    table[:, 1:4],
                    table[:, 4:] * (2.0 * np.pi / per_turn),
                )
            )
    except (OSError, KeyError, IndexError, ValueError) as error:
        msg = (
            f"{file}: cannot be read as the authors describe it ({error!r});"
            " clone sousarbarb/odometry-calibration again"
        )
        raise FailedError(msg) from None
    return runs


def sets_of_squares(runs: Iterable[Run]) -> list[str]:
    """Return the sets of squares that are large enough to learn from."""
    counts = Counter(run.data_set for run in runs)
    return [
        name
        for name, count in counts.items()
        if name.startswith("square/") and count >= FEWEST_RUNS
    ]


def write_table(file: Path, runs: Sequence[Run], machine: Machine) -> None:
    """Write runs as the table that the robot's mapping reads, a segment for each."""
    with file.open("w", newline="", encoding="utf-8") as opened:
        table = csv.writer(opened)
        table.writerow(("t_s", "segment", "x_m", "y_m", "yaw_rad", *machine.columns))
        for segment, run in enumerate(runs):
            every = max(round(1.0 / (FASTEST_HZ * float(np.diff(run.t_s).mean()))), 1)
            total = np.cumsum(run.turned_rad, axis=0)[::every]
            t_s = run.t_s[::every] - run.t_s[0]
            speeds = np.diff(total, axis=0, prepend=total[:1])
            speeds[1:] /= np.diff(t_s)[:, None]
            for at_s, pose, speed in zip(t_s, run.pose[::every], speeds, strict=True):
                cells = [f"{value:.6f}" for value in (*pose, *speed)]
                table.writerow((f"{at_s:.4f}", segment, *cells))
