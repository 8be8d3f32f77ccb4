"""Real recordings with motion capture: the navigation is silent every other 20 s.

Each robot is diagnosed from drives of one kind and observed on drives of another. It is compared
with the wheels alone without the patch, and a filter with default covariances. The time stamps of
the capture are corrected for all of them, and for the truth, by the clock that the diagnosis found.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from benchmarks.constant_filter import constant_filter
from benchmarks.default_filter import default_filter
from benchmarks.diagnose_results import sources
from benchmarks.observer_drives import Known, diagnosed
from hilserver.arrays import Array, Indices
from hilserver.bench.report import Result
from hilserver.config.observer import constants_of
from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.errors import FailedError
from hilserver.measured.machine import machine_config
from hilserver.measured.observed import series_of
from hilserver.measured.reading import read_measured
from hilserver.observer.layout import PLACE, Shown
from hilserver.observer.log_noise import fitted
from hilserver.observer.offline import POSITION, MeasuredSeries, run
from hilserver.observer.smoother import smooth
from hilserver.plant.packing import pack
from hilserver.plant.parameters import RobotParameters

MAPPINGS: Final = Path(__file__).parents[1] / "docs" / "how-to" / "mappings"
CUT_S: Final = 20.0
STATE: Final = Shown.where("state").start
HOW: Final = (
    "observer",
    "wheels since the cut",
    "wheels since the start",
    "default covariances",
)


@dataclass(frozen=True)
class Machine:
    """Drives of one robot in a folder of recordings."""

    folder: str
    mapping: str
    learned: str  # pattern of the diagnosed logs
    driven: str  # pattern of the observed logs


MACHINES: Final = (
    Machine(
        "diffdrive_umbmark", "diffdrive", "square_230620202042.csv", "circular_*.csv"
    ),
    Machine("omni4", "omni4", "square_*.csv", "circular_*.csv"),
)


@dataclass(frozen=True)
class Drive:
    """Results of one drive.

    Attributes
    ----------
    errors : ndarray, shape (cuts, 4)
        Errors of the position at the end of each cut [m], in the order of `HOW`.
    nees : ndarray, shape (cuts,)
        NEES of the observer's position there.
    nis : ndarray
        NIS of the position samples, by their number of values.
    errors: Array
    tracked : ndarray, shape (n, 2)
        Errors of the position where the pose is there [m]: observer, constant covariances.
    smoothed : ndarray, shape (n, 2)
        Errors of the position everywhere [m]: smoother, filter.
    """

    errors: Array
    nees: Array
    nis: Array
    tracked: Array
    smoothed: Array


def measure(
    root: Path, keep: Path, jobs: int, *, undiagnosed: bool = False
) -> list[Result]:
    """Return the figures of all robots with recordings; a diagnosis uses `jobs` threads.

    Parameters
    ----------
    undiagnosed : bool
        The observer knows what is configured, as its rivals do.

    Raises
    ------
    FailedError
        If there are no recordings.
    """
    there = [one for one in MACHINES if any((root / one.folder).glob(one.learned))]
    if not there:
        folders = ", ".join(one.folder for one in MACHINES)
        raise FailedError(f"--recordings {root}: holds no recordings of {folders}")
    return [
        row
        for one in there
        for row in _figures(one, list(_drives(one, root, keep, jobs, undiagnosed)))
    ]


def _drives(
    one: Machine, root: Path, keep: Path, jobs: int, undiagnosed: bool
) -> Iterator[Drive]:
    learned, driven = (
        sorted((root / one.folder).glob(p)) for p in (one.learned, one.driven)
    )
    mapping = MAPPINGS / f"{one.mapping}.yaml"
    log = read_measured(learned, mapping)
    config = machine_config(log, Config())
    plain = assemble_config(config).robot
    if undiagnosed:
        print(f"{one.folder}: {len(driven)} logs observed", flush=True)
        known = Known(plain, constants_of(plain, None))
    else:
        print(
            f"{one.folder}: diagnosed once into {keep}, then {len(driven)} logs observed",
            flush=True,
        )
        known = diagnosed(keep / sources() / one.folder, lambda: log, config, jobs)
    for file in driven:
        log = read_measured([file], mapping)
        for span in range(len(log.spans)):
            own, raw = (
                series_of(log, span, r, known.late_s) for r in (known.robot, plain)
            )
            if np.ptp(own.wheels[:, 0]) > 2.1 * CUT_S:
                yield _drive(known, plain, own, raw)


def _silent(t: Array, start: float) -> NDArray[np.bool_]:
    return np.asarray((t - start) % (2.0 * CUT_S) >= CUT_S)


def _drive(
    known: Known, plain: RobotParameters, own: MeasuredSeries, raw: MeasuredSeries
) -> Drive:
    t = own.wheels[:, 0]
    cut = _silent(t, t[0])
    begins = np.flatnonzero(~cut[:-1] & cut[1:])
    # a silence that lasts past the end is not counted
    begins = begins[t[begins] + CUT_S < t[-1]]
    ends = np.array([k + int(np.argmin(cut[k + 1 :])) for k in begins])
    true = _truth(raw, t)
    rest = [
        MeasuredSeries(s.wheels, s.samples[~_silent(s.samples[:, 1], t[0])])
        for s in (own, raw)
    ]
    own_p = pack(known.robot)
    c = fitted(own_p, known.constants, [rest[0]])
    course = run(own_p, c, rest[0])
    base = pack(plain)
    wheels = run(
        base, constants_of(plain, None), MeasuredSeries(raw.wheels, np.zeros((0, 4)))
    ).estimate
    rival = default_filter(base, rest[1])
    paths = (
        course.estimate[ends, :2],
        _reckoned(wheels, true, begins, ends),
        _reckoned(wheels, true, np.zeros_like(begins), ends),
        rival[ends, :2],
    )
    away = [path - true[ends, :2] for path in paths]
    weighed = np.linalg.solve(course.covariance[ends, :2, :2], away[0][:, :, None])[
        :, :, 0
    ]
    errors = np.stack([np.hypot(*one.T) for one in away], axis=1)
    nis = course.innovations[np.isfinite(course.innovations[:, PLACE]), PLACE]

    first = int(np.flatnonzero(course.shown[:, STATE] > 0.0)[0])
    smoothed, _ = smooth(own_p, c, rest[0], course, first)
    of_filter = _off(course.estimate, true)[first:]
    of_rival = _off(constant_filter(base, rest[1]), true)[first:]
    of_smoother = _off(smoothed, true)[first:]
    there = ~cut[first:]
    return Drive(
        errors,
        (away[0] * weighed).sum(axis=1),
        nis,
        np.stack([of_filter, of_rival], axis=1)[there],
        np.stack([of_smoother, of_filter], axis=1),
    )


def _off(path: Array, true: Array) -> Array:
    return np.asarray(np.hypot(*(path[:, :2] - true[:, :2]).T))


def _truth(series: MeasuredSeries, t: Array) -> Array:
    """Return x, y [m] and yaw [rad] from the capture, shape (n, 3)."""
    s = series.samples
    place, heading = s[s[:, 0] == POSITION], s[s[:, 0] > POSITION]
    yaw = np.unwrap(heading[:, 2])
    return np.stack(
        [np.interp(t, place[:, 1], place[:, 2]), np.interp(t, place[:, 1], place[:, 3]),
         np.interp(t, heading[:, 1], yaw)], axis=1)  # fmt: skip


def _reckoned(wheels: Array, true: Array, begins: Indices, ends: Indices) -> Array:
    """Return the positions at `ends` by the wheels alone, from the true poses at `begins`."""
    turn = true[begins, 2] - wheels[begins, 2]
    way = (wheels[ends, 0] - wheels[begins, 0]) + 1j * (
        wheels[ends, 1] - wheels[begins, 1]
    )
    way = way * np.exp(1j * turn)
    path: Array = true[begins, :2] + np.stack([way.real, way.imag], axis=1)
    return path


def _figures(one: Machine, drives: list[Drive]) -> list[Result]:
    errors = np.concatenate([drive.errors for drive in drives])
    nis, nees = (
        np.concatenate([getattr(d, name) for d in drives]) for name in ("nis", "nees")
    )
    ours, *others = np.median(errors, axis=0).tolist()
    name = f"{one.folder}, {len(errors)} cuts"
    rows = [
        Result(f"{name}: error", ours, "m", other, how, other / ours)
        for how, other in zip(HOW[1:], others, strict=True)
    ]
    for kind, field, how in (
        ("RMS where the pose is there", "tracked", "constant covariances"),
        ("RMS of the smoother", "smoothed", "filter"),
    ):
        off = np.concatenate([getattr(drive, field) for drive in drives])
        ours, other = np.sqrt(np.mean(off * off, axis=0)).tolist()
        rows.append(Result(f"{name}: {kind}", ours, "m", other, how, other / ours))
    inside = float((nis < chi2.ppf(0.95, 2) / 2.0).mean())
    ended = float((nees < chi2.ppf(0.95, 2)).mean())
    return [
        *rows,
        Result(f"{name}: inside its ellipse of 95 %", ended, "1", 0.95, "wanted"),
        Result(f"{name}: NIS, mean", float(nis.mean()), "1", 1.0, "chi-squared"),
        Result(f"{name}: NIS inside 95 %", inside, "1", 0.95, "wanted"),
    ]
