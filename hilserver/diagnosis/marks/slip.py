"""How far apart two runs of one machine end by chance: wheels that slip a little, again and again.

Each wheel's distance differs from its encoder's by a random walk whose variance grows with the
distance rolled (Chong and Kleeman 1997), so a long run and one with many turns say less. The
variance per metre is estimated from the scatter that no cause explains (restricted likelihood).
"""

from typing import Final

import numpy as np

from hilserver.arrays import Array, Indices
from hilserver.diagnosis.marks.runs import MarkedRuns

PIECES: Final = 40  # of a run, each of which slips by itself
KICK: Final = 1e-4  # [rad, m], small beside what marks can show
NO_MOVE: Final = 1e-9  # share of the largest variance
TRIED: Final = np.concatenate([[0.0], np.logspace(-2, 6, 33)])
"""Variances, as multiples of that at which slip and the marks' inexactness count alike."""


class RandomSlip:
    """What random slip does to the marks, near the configured robot.

    Attributes
    ----------
    rows : list of ndarray of int
        Of each run, where its rows are.
    ways : list of ndarray, shape (rows of the run, ways)
        Orthonormal directions into which slip moves the rows of a run.
    sizes : list of ndarray, shape (ways,)
        Variance along each [multiples of the marks' variance, per m² of slip per metre].
    unit : float
        Variance per metre [m] at which slip counts as much as the marks' inexactness.
    """

    def __init__(self, runs: MarkedRuns) -> None:
        effect = _effect(runs)
        self.rows = [np.flatnonzero(runs.run == run) for run in range(len(runs.marks))]
        self.ways: list[Array] = []
        self.sizes: list[Array] = []
        for rows in self.rows:
            ways, size, _ = np.linalg.svd(effect[rows], full_matrices=False)
            moved = size**2 > NO_MOVE * max(float(size.max(initial=0.0)) ** 2, 1e-300)
            self.ways.append(ways[:, moved])
            self.sizes.append(size[moved] ** 2)
        largest = [float(size.max()) for size in self.sizes if size.size]
        self.unit = 1.0 / float(np.median(largest)) if largest else 0.0

    def whitened(self, columns: Array, slip_m: float) -> Array:
        """Return rows of unit variance and without correlation.

        Parameters
        ----------
        columns : ndarray, shape (rows,) or (rows, k)
            In standard deviations of the marks.
        slip_m : float
            Variance of a wheel's distance per metre.
        """
        out = columns.copy()
        if slip_m == 0.0:
            return out
        for rows, ways, sizes in zip(self.rows, self.ways, self.sizes, strict=True):
            smaller = 1.0 - (1.0 + slip_m * sizes) ** -0.5
            along = ways.T @ columns[rows]
            out[rows] -= ways @ (smaller * along.T).T
        return out

    def estimate(self, missed: Array, effects: Array, chosen: Indices) -> float:
        """Return the variance per metre that explains best what no cause explains.

        Parameters
        ----------
        missed : ndarray, shape (rows,)
        effects : ndarray, shape (rows, k)
            Independent effects of all causes.
        chosen : ndarray of int
            The runs that take part.
        """
        rows = np.concatenate([self.rows[run] for run in chosen])
        sizes = np.concatenate([self.sizes[run] for run in chosen])
        likely = []
        for slip_m in TRIED * self.unit:
            white = self.whitened(np.column_stack([missed, effects]), slip_m)[rows]
            others, upper = np.linalg.qr(white[:, 1:])
            left = white[:, 0] - others @ (others.T @ white[:, 0])
            spread = np.log1p(slip_m * sizes).sum()
            spread += 2.0 * np.log(np.abs(np.diag(upper))).sum()
            likely.append(-0.5 * (spread + left @ left))
        return float(TRIED[int(np.argmax(likely))] * self.unit)


def _effect(runs: MarkedRuns) -> Array:
    """Return what slip of one m² per metre does to the rows, shape (rows, 3 * PIECES)."""
    course = runs.course({})
    poses = runs.poses_in(course)
    base = runs.missed(poses)
    times_s, pivots, rolled_m = _pieces(runs, course)
    track_m = runs.stage.robot.track_m

    run, columns = runs.run_of_point, []
    for piece in range(PIECES):
        later = runs.times_s > times_s[run, piece]
        x, y, yaw = pivots[run, piece].T
        ahead, zero = later * np.cos(yaw), np.zeros(len(run))
        aside = later * np.sin(yaw)
        kicks = (
            (np.stack([y - poses[:, 1], poses[:, 0] - x, zero + 1.0], 1), 2 / track_m**2),
            (np.stack([ahead, aside, zero], 1), 0.5),
            (np.stack([-aside, ahead, zero], 1), 0.5),
        )  # fmt: skip
        for kick, variance in kicks:
            moved = runs.missed(poses + KICK * later[:, None] * kick) - base
            sd = np.sqrt(variance * rolled_m[runs.run, piece])
            columns.append(moved / KICK / runs.sd * sd)
    return np.stack(columns, axis=1)


def _pieces(runs: MarkedRuns, course: Array) -> tuple[Array, Array, Array]:
    """Return time, pose and distance of the farther wheel of all pieces of all runs."""
    segments, half_m = runs.stage.segments, 0.5 * runs.stage.robot.track_m
    times_s = np.empty((len(runs.marks), PIECES))
    pivots, rolled_m = np.empty((*times_s.shape, 3)), np.empty(times_s.shape)
    for run, segment in enumerate(runs.segments):
        own = course[segments.first[segment] : segments.first[segment + 1]]
        step = abs(np.diff(own, axis=0))
        farther_m = np.maximum(np.hypot(step[:, 0], step[:, 1]), half_m * step[:, 2])
        so_far_m = np.concatenate([[0.0], np.cumsum(farther_m)])

        t_s, marked_s = segments.times(segment), runs.times_s[runs.run_of_point == run]
        edges_s = np.linspace(marked_s.min(), marked_s.max(), PIECES + 1)
        times_s[run] = (edges_s[1:] + edges_s[:-1]) / 2
        rolled_m[run] = np.diff(np.interp(edges_s, t_s, so_far_m))
        places = [np.interp(times_s[run], t_s, c) for c in own.T]
        pivots[run] = np.stack(places, axis=1)
    return times_s, pivots, rolled_m
