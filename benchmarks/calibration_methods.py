"""Published calibrations of a robot's odometry, and the odometry that each of them makes.

- Borenstein, Feng: UMBmark, IEEE Trans. Robotics and Automation 12 (1996): unequal diameters and a
  wrong track width, from the positions after squares in both directions.
- Jung, Chung: accurate calibration of a differential drive, ICRA 2012: the same from the headings.
- Sousa et al.: OptiOdom (2022): all dimensions, by the positions every 0.5 m of a run.
- Lin et al.: ICCSE 2019: the matrix from wheels to body, by linear least squares.

Errors are measured minus computed, and turns to the left positive, as the authors have them.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from benchmarks.calibration_runs import DIFFERENTIAL, ROLLERS, Machine, Run
from hilserver.arrays import Array

SAMPLES_M: Final = 0.5  # distance between the positions that are compared
Matrix = Array
"""Shape (3, wheels): what a radian of each wheel moves the body ahead, aside [m], and turns it."""
Method = Callable[[Machine, Sequence[Run]], Matrix]


def configured(machine: Machine, runs: Sequence[Run] = ()) -> Matrix:
    """Return the matrix of the configured dimensions."""
    del runs
    wheels = len(machine.columns)
    return of_dimensions(
        machine, np.array([machine.width_m] + wheels * [machine.wheel_diameter_m])
    )


def of_dimensions(machine: Machine, dimensions: Array) -> Matrix:
    """Return the matrix of a width and of the wheels' diameters."""
    width_m, radii_m = dimensions[0], 0.5 * dimensions[1:]
    if machine is DIFFERENTIAL:
        right, left = radii_m
        return np.array(
            [[0.5 * right, 0.5 * left], [0.0, 0.0], [right / width_m, -left / width_m]]
        )
    signs = np.array([[1, -1, 1, -1], [-1, -1, 1, 1], [-1, -1, -1, -1]])
    shares = np.array([0.25, 0.25, 0.5 / width_m])
    return np.asarray(signs * shares[:, None] * radii_m)


def odometry(matrix: Matrix, run: Run) -> Array:
    """Return the computed pose of every row, shape (n, 3), from the first measured one."""
    moved = run.turned_rad @ matrix.T
    moved[0] = 0.0
    heading = run.pose[0, 2] + np.cumsum(moved[:, 2])
    # ahead and aside hold on the arc between two rows, whose chord has the mean heading
    chord = np.sinc(moved[:, 2] / (2.0 * np.pi))
    between = np.exp(1j * (heading - 0.5 * moved[:, 2]))
    place = run.pose[0, 0] + 1j * run.pose[0, 1]
    place = place + np.cumsum(chord * (moved[:, 0] + 1j * moved[:, 1]) * between)
    return np.stack([place.real, place.imag, heading], axis=1)


def missed(matrix: Matrix, run: Run) -> Array:
    """Return what is measured minus what is computed at the end: x, y [m], heading [rad]."""
    off: Array = run.pose[-1] - odometry(matrix, run)[-1]
    off[2] = np.angle(np.exp(1j * off[2]))
    return off


def umbmark(machine: Machine, runs: Sequence[Run]) -> Matrix:
    """Return Borenstein and Feng's correction, the mean of those of all sets of squares."""
    return _of_squares(machine, runs, _by_position)


def jung_and_chung(machine: Machine, runs: Sequence[Run]) -> Matrix:
    """Return Jung and Chung's correction, the mean of those of all sets of squares."""
    return _of_squares(machine, runs, _by_heading)


def _of_squares(
    machine: Machine,
    runs: Sequence[Run],
    angles: Callable[[Array, Array, float, float], tuple[float, float]],
) -> Matrix:
    as_configured, found = configured(machine), []
    width_m, diameter_m = machine.width_m, machine.wheel_diameter_m
    squares: dict[str, dict[bool, list[Run]]] = {}
    for run in runs:
        if np.isfinite(run.side_m):
            directions = squares.setdefault(run.data_set, {True: [], False: []})
            directions[run.clockwise].append(run)
    for directions in squares.values():
        if not all(directions.values()):
            continue
        ends = {
            way: np.mean([missed(as_configured, run) for run in some], axis=0)
            for way, some in directions.items()
        }
        side_m = directions[True][0].side_m
        alpha, beta = angles(ends[True], ends[False], side_m, width_m)
        width = width_m * (0.5 * np.pi) / (0.5 * np.pi - alpha)
        radius = 0.5 * side_m / np.sin(0.5 * beta) if beta else np.inf
        # by how much the right wheel is larger than the left one, as a share of both
        apart = 0.5 * width / radius
        right, left = diameter_m * (1.0 + apart), diameter_m * (1.0 - apart)
        found.append((width, right, left))
    if not found:
        return as_configured
    return of_dimensions(machine, np.mean(found, axis=0))


def _by_position(
    clockwise: Array, other: Array, side_m: float, width_m: float
) -> tuple[float, float]:
    del width_m
    both, apart = clockwise[0] + other[0], clockwise[0] - other[0]
    return float(-0.25 * both / side_m), float(-0.25 * apart / side_m)


def _by_heading(
    clockwise: Array, other: Array, side_m: float, width_m: float
) -> tuple[float, float]:
    beta = float(clockwise[2] + other[2]) / 8.0
    on_the_spot = np.pi * width_m * beta / (4.0 * side_m)
    return float(clockwise[2] - other[2]) / 8.0 + on_the_spot, beta


def optiodom(machine: Machine, runs: Sequence[Run]) -> Matrix:
    """Return the dimensions that meet the positions every 0.5 m best, from each run's beginning."""
    wheels = len(machine.columns)
    start = np.array([machine.width_m] + wheels * [machine.wheel_diameter_m])
    rows = [_samples(configured(machine), run) for run in runs]

    def off(dimensions: Array) -> Array:
        matrix = of_dimensions(machine, dimensions)
        parts = [
            (odometry(matrix, run)[own, :2] - run.pose[own, :2]).ravel()
            for run, own in zip(runs, rows, strict=True)
        ]
        return np.concatenate(parts)

    return of_dimensions(machine, least_squares(off, start, x_scale=start).x)


def lin(machine: Machine, runs: Sequence[Run]) -> Matrix:
    """Return the matrix by linear least squares: first the turns, then with these the ways."""
    first = configured(machine)
    rows = [_samples(first, run) for run in runs]
    totals = [
        np.cumsum(run.turned_rad, axis=0) - run.turned_rad[0] for run in runs
    ]  # of each wheel since the beginning
    turns = [
        run.pose[own, 2] - run.pose[0, 2] for run, own in zip(runs, rows, strict=True)
    ]
    turned = np.concatenate([t[own] for t, own in zip(totals, rows, strict=True)])
    turn = np.linalg.lstsq(turned, np.concatenate(turns), rcond=None)[0]

    ways, places = [], []
    # the shares of ahead and aside differ in their signs alone
    ahead, aside = np.sign(first[:2])
    for run, total, own in zip(runs, totals, rows, strict=True):
        along = np.exp(1j * (run.pose[0, 2] + total @ turn))[:, None]
        steps = run.turned_rad * (ahead + 1j * aside) * along
        steps[0] = 0.0
        way = np.cumsum(steps, axis=0)[own]
        place = (run.pose[own, :2] - run.pose[0, :2]) @ np.array([1.0, 1j])
        ways += [way.real, way.imag]
        places += [place.real, place.imag]
    share = np.linalg.lstsq(np.concatenate(ways), np.concatenate(places), rcond=None)[0]
    return np.stack([share * ahead, share * aside, turn])


def _samples(matrix: Matrix, run: Run) -> Array:
    """Return the rows after every 0.5 m of way, and the last one."""
    way = np.cumsum(np.hypot(*(run.turned_rad @ matrix.T)[:, :2].T))
    passed = np.searchsorted(way, np.arange(SAMPLES_M, way[-1], SAMPLES_M))
    return np.unique(np.append(passed, len(way) - 1))


METHODS: Final[Mapping[str, Mapping[str, Method]]] = {
    DIFFERENTIAL.name: {
        "as configured": configured,
        "UMBmark": umbmark,
        "Jung and Chung": jung_and_chung,
        "OptiOdom": optiodom,
    },
    ROLLERS.name: {
        "as configured": configured,
        "Lin et al.": lin,
        "OptiOdom": optiodom,
    },
}
