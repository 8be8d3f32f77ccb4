"""The runs of a log that have marks, and how far a model misses them."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from hilserver.arrays import Array, Indices, Mask
from hilserver.diagnosis.replay.pose_stage import PoseStage
from hilserver.measured.floor_marks import FloorMark

BEGIN_STEPS = 4
MISSES_KEPT = (
    64  # predictions that are needed again: the base, and models of several folds
)


class MarkedRuns:
    """Marks and the replay that has to meet them.

    A run begins where the marks that it has say best; relative marks do not depend on that.

    Attributes
    ----------
    run : ndarray of int, shape (rows,)
        The run of each number that was marked: x, y, distance or heading.
    sd : ndarray, shape (rows,)
        Its standard deviation.
    is_place : ndarray of bool, shape (rows,)
        Whether it is a length [m], not a heading [rad].
    freedom : ndarray of int, shape (runs,)
        What the marks of each run show besides where it began.
    """

    def __init__(self, stage: PoseStage) -> None:
        self.stage = stage
        self._kept: dict[tuple[tuple[str, float], ...], Array] = {}
        spans = stage.segments.span.tolist()
        own = [
            (spans.index(m.span), m.mark) for m in stage.log.marks if m.span in spans
        ]
        self.segments = sorted({segment for segment, _ in own})
        self.marks = [[m for s, m in own if s == segment] for segment in self.segments]

        rows = [_rows(marks) for marks in self.marks]
        self.run = np.repeat(np.arange(len(rows)), [len(sd) for sd, _ in rows])
        self.sd = np.array([sd for sds, _ in rows for sd in sds])
        self.is_place = np.array([one for _, kinds in rows for one in kinds], bool)
        free = [_free_directions(marks) for marks in self.marks]
        self.freedom = np.bincount(self.run, minlength=len(rows)) - np.array(free, int)

    def residual(self, terms: Mapping[str, float]) -> Array:
        """Return by how much a model misses the marks, in standard deviations, shape (rows,)."""
        key = tuple(sorted(terms.items()))
        if key not in self._kept:
            if len(self._kept) >= MISSES_KEPT:
                del self._kept[next(iter(self._kept))]
            self._kept[key] = self._missed(terms) / self.sd
        return self._kept[key]

    def _missed(self, terms: Mapping[str, float]) -> Array:
        segments = self.stage.segments
        dense = self.stage.simulate(terms, np.zeros((len(segments), 3)))
        missed = []
        for segment, marks in zip(self.segments, self.marks, strict=True):
            t_s = segments.times(segment)
            course = dense[segments.first[segment] : segments.first[segment + 1], :3]

            def at(
                when: Sequence[float], t_s: Array = t_s, course: Array = course
            ) -> Array:
                return np.stack([np.interp(when, t_s, c) for c in course.T], axis=1)

            absolute = [m for m in marks if m.x_m is not None]
            relative = [m for m in marks if m.x_m is None]
            if absolute:
                missed += _of_places(absolute, at([m.t_s for m in absolute]))
            for mark in relative:
                here, there = at([mark.t_s, float(mark.other_t_s or 0.0)])
                missed += _of_relation(mark, here, there)
        return np.array(missed)


def _rows(marks: Sequence[FloorMark]) -> tuple[list[float], list[bool]]:
    """Return standard deviations and kinds of all rows of a run, absolute marks first."""
    sd: list[float] = []
    kinds: list[bool] = []
    for mark in sorted(marks, key=lambda m: m.x_m is None):
        lengths = 1 if mark.forward_m is not None else 2
        headings = int(mark.yaw_rad is not None)
        sd += [mark.sd_m] * lengths + [mark.yaw_sd_rad] * headings
        kinds += [True] * lengths + [False] * headings
    return sd, kinds


def _free_directions(marks: Sequence[FloorMark]) -> int:
    """Return how many numbers of a run say where it began."""
    absolute = [m for m in marks if m.x_m is not None]
    if not absolute:
        return 0
    return 3 if _turns(absolute) else 2


def _turns(absolute: Sequence[FloorMark]) -> bool:
    """Return whether absolute marks show the heading in which a run began.

    If all of them are at one place and none has a heading, only their distances count.
    """
    if any(m.yaw_rad is not None for m in absolute):
        return True
    apart_m = np.ptp([(m.x_m or 0.0, m.y_m or 0.0) for m in absolute], axis=0).max()
    return bool(apart_m > 5.0 * max(m.sd_m for m in absolute))


def _of_places(marks: Sequence[FloorMark], course: Array) -> list[float]:
    """Return by how much a course misses absolute marks, if it begins where it fits them best."""
    marked = np.array([complex(m.x_m or 0.0, m.y_m or 0.0) for m in marks])
    driven = course[:, 0] + 1j * course[:, 1]
    weight = np.array([m.sd_m**-2 for m in marks])
    weight /= weight.sum()
    known = [i for i, m in enumerate(marks) if m.yaw_rad is not None]
    headings = np.array([marks[i].yaw_rad for i in known], float)
    turns = _turns(marks)

    yaw = 0.0
    if known:
        yaw = float(np.angle(np.exp(1j * (headings - course[known, 2])).mean()))
    elif turns:
        off = np.conj(driven - weight @ driven) * (marked - weight @ marked)
        yaw = float(np.angle(weight @ off))
    begin = weight @ (marked - driven * np.exp(1j * yaw))

    sd = np.array([m.sd_m for m in marks])
    yaw_sd = np.array([marks[i].yaw_sd_rad for i in known])
    for _ in range(BEGIN_STEPS if turns else 0):
        turned = driven * np.exp(1j * yaw)
        off = (marked - begin - turned) / sd
        off_yaw = _wrapped(headings - course[known, 2] - yaw) / yaw_sd
        one, none = 1.0 / sd, np.zeros(len(sd))
        columns = np.block([
            [one[:, None], none[:, None], (-turned.imag / sd)[:, None]],
            [none[:, None], one[:, None], (turned.real / sd)[:, None]],
            [np.zeros((len(known), 2)), (1.0 / yaw_sd)[:, None]],
        ])  # fmt: skip
        missed = np.concatenate([off.real, off.imag, off_yaw])
        step = np.linalg.lstsq(columns, missed, rcond=1e-9)[0]
        begin, yaw = begin + complex(step[0], step[1]), yaw + float(step[2])

    off = marked - begin - driven * np.exp(1j * yaw)
    off_yaw = dict(zip(known, _wrapped(headings - course[known, 2] - yaw), strict=True))
    out: list[float] = []
    for i, place in enumerate(off):
        out += [place.real, place.imag]
        out += [float(off_yaw[i])] if i in off_yaw else []
    return out


def _of_relation(mark: FloorMark, here: Array, there: Array) -> list[float]:
    """Return by how much a course misses a mark that refers to another time."""
    moved = complex(*(here[:2] - there[:2])) * np.exp(-1j * there[2])
    if mark.forward_m is None:
        out = [-moved.real, -moved.imag]
    else:
        out = [mark.forward_m - math.copysign(abs(moved), mark.forward_m or 1.0)]
    if mark.yaw_rad is not None:
        out.append(float(_wrapped(mark.yaw_rad - (here[2] - there[2]))))
    return out


def _wrapped(angle: Array | float) -> Array:
    return np.asarray(np.arctan2(np.sin(angle), np.cos(angle)))


def rows_of(runs: MarkedRuns, chosen: Indices) -> Mask:
    """Return which rows belong to some runs."""
    return np.isin(runs.run, chosen)
