"""The runs of a log that have marks, and how far a model misses them."""

from collections.abc import Callable, Mapping, Sequence
from typing import Final

import numpy as np

from hilserver.arrays import Array, Indices, Mask
from hilserver.diagnosis.replay.pose_stage import PoseStage
from hilserver.measured.floor_marks import FloorMark

YAW_STEPS: Final = 3
ONE_PLACE: Final = 5.0  # standard deviations; marks that are nearer may be one place
DISTINCT: Final = (
    2.0  # a distance's miss must be so many times smaller, or its sign is unknown
)
# predictions that are needed again: the base, and models of several folds
MISSES_KEPT: Final = 64


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
    times_s : ndarray, shape (points,)
        When each pose is needed: that of all marks, then that which relative marks refer to.
    run_of_point : ndarray of int, shape (points,)
    lost : int
        Runs that show nothing: they end where they began, and no heading is marked.
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
        self._flatten()
        poses = self.poses_in(self.course({}))
        count = len(self.marks)
        places = np.bincount(self._run_of[self._placed], minlength=count)
        lost = (places > 0) & ~self._meet_without_heading(poses)
        begins = np.where(self._turns, 3, 2) * (places > 0)
        rows = np.bincount(self.run, minlength=count)
        self.freedom = np.where(lost, 0, rows - begins)
        self.lost = int(lost.sum())

    def _flatten(self) -> None:
        """Write all marks as columns; absolute and relative ones have indices."""
        marks = [mark for own in self.marks for mark in own]
        self._run_of = np.repeat(np.arange(len(self.marks)), list(map(len, self.marks)))
        self._placed = _where(marks, lambda m: m.x_m is not None)
        self._same = _where(marks, lambda m: m.same_as_t_s is not None)
        self._ahead = _where(marks, lambda m: m.forward_m is not None)
        headed = _where(marks, lambda m: m.yaw_rad is not None)
        self._headings = np.intersect1d(headed, self._placed)
        self._turned = np.setdiff1d(headed, self._placed)

        self._marked = np.array([complex(m.x_m or 0.0, m.y_m or 0.0) for m in marks])
        self._forward_m = np.array([m.forward_m or 0.0 for m in marks])
        self._yaw = np.array([m.yaw_rad or 0.0 for m in marks])
        self._sd_m = np.array([m.sd_m for m in marks])
        self._yaw_sd = np.array([m.yaw_sd_rad for m in marks])
        others = [m.t_s if m.other_t_s is None else m.other_t_s for m in marks]
        self.times_s = np.array([*(m.t_s for m in marks), *others])
        self.run_of_point = np.tile(self._run_of, 2)

        # the rows of a course between which each point lies
        segments = self.stage.segments
        segment = np.array(self.segments, int)[self.run_of_point]
        since_s = self.times_s - segments.start_s[segment] + segments.lead_s
        first, last = segments.first[segment], segments.first[segment + 1] - 1
        at = np.clip(first + since_s / segments.period_s, first, last)
        self._row = np.minimum(at.astype(np.int64), last - 1)
        self._beyond = at - self._row

        lengths = [*[self._placed] * 2, *[self._same] * 2, self._ahead]
        angles = [self._headings, self._turned]
        of_row = np.concatenate(lengths + angles)
        self.run = self._run_of[of_row]
        self.is_place = np.arange(len(of_row)) < sum(map(len, lengths))
        self.sd = np.where(self.is_place, self._sd_m[of_row], self._yaw_sd[of_row])

    def _meet_without_heading(self, poses: Array) -> Mask:
        """Return which runs can be compared; find those whose marks show their first heading.

        The direction of a mark is unknown in a run without a heading. Where all marks may be one
        place, they count as one that is known so much worse; elsewhere only the distance counts.
        Either says something about a robot only if it was driven much farther than that.
        """
        count, run = len(self.marks), self._run_of[self._placed]
        driven = abs(self._from_middle(_complex(poses)[self._placed]))
        marked = abs(self._from_middle(self._marked[self._placed]))
        sd_m = self._sd_m[self._placed]

        def most(values: Array) -> Array:
            found = np.zeros(count)
            np.maximum.at(found, run, values)
            return found

        self._headed = np.bincount(self._run_of[self._headings], minlength=count) > 0
        self._turns = self._headed | (2.0 * most(marked) > ONE_PLACE * most(sd_m))
        vague = np.where(self._turns, most(abs(driven - marked)), most(marked))
        one = ~self._turns[run]
        self._marked[self._placed[one]] = 0.0
        worse = np.where(one, np.hypot(sd_m, marked), sd_m)
        self.sd[: 2 * len(run)] = np.tile(worse, 2)
        return np.asarray(self._headed | (most(driven) > DISTINCT * vague))

    def _from_middle(self, values: Array) -> Array:
        """Return absolute marks, or what a replay says of them, from the middle of their run."""
        run, weight = self._run_of[self._placed], self._sd_m[self._placed] ** -2.0
        total = self._sums(run, weight).real
        middle = self._sums(run, weight * values) / np.maximum(total, 1e-300)
        return np.asarray(values - middle[run])

    def _sums(self, run: Indices, values: Array) -> Array:
        """Return the sums of each run, complex."""
        count, values = len(self.marks), np.asarray(values, complex)
        real, imaginary = (
            np.bincount(run, part, count) for part in (values.real, values.imag)
        )
        return np.asarray(real + 1j * imaginary)

    def course(self, terms: Mapping[str, float]) -> Array:
        """Return x, y and yaw of a model at every tick, each segment from zero."""
        segments = self.stage.segments
        return self.stage.simulate(terms, np.zeros((len(segments), 3)))[:, :3]

    def poses_in(self, course: Array) -> Array:
        """Return the poses of a course at the times of all points, shape (points, 3)."""
        before, after = course[self._row], course[self._row + 1]
        return np.asarray(before + self._beyond[:, None] * (after - before))

    def residual(self, terms: Mapping[str, float]) -> Array:
        """Return by how much a model misses the marks, in standard deviations, shape (rows,)."""
        key = tuple(sorted(terms.items()))
        if key not in self._kept:
            if len(self._kept) >= MISSES_KEPT:
                del self._kept[next(iter(self._kept))]
            self._kept[key] = self.missed(self.poses_in(self.course(terms))) / self.sd
        return self._kept[key]

    def missed(self, poses: Array) -> Array:
        """Return by how much poses at all points miss the marks [m, rad], shape (rows,)."""
        here, there = np.split(poses, 2)
        moved = (_complex(here) - _complex(there)) * np.exp(-1j * there[:, 2])
        same, sign = moved[self._same], np.where(self._forward_m < 0.0, -1.0, 1.0)
        ahead = (self._forward_m - sign * abs(moved))[self._ahead]
        turned = _wrapped(self._yaw - here[:, 2] + there[:, 2])[self._turned]
        off, off_yaw = self._of_places(here)
        return np.concatenate(
            [off.real, off.imag, -same.real, -same.imag, ahead, off_yaw, turned]
        )

    def ends(self, terms: Mapping[str, float]) -> Array:
        """Return where each model's run ends, seen from its mark [m], shape (runs, 2).

        Forward and to the left, as the robot stood when the run began; NaN for runs whose marks do
        not say how it stood. The run begins as marked, not where it would fit best.
        """
        here, there = np.split(self.poses_in(self.course(terms)), 2)
        moved = (_complex(here) - _complex(there)) * np.exp(-1j * there[:, 2])
        found = np.full(len(self.marks), complex(np.nan, np.nan))
        found[self._run_of[self._same]] = moved[self._same]
        for run in range(len(self.marks)):
            own = self._placed[self._run_of[self._placed] == run]
            if len(own) < 2 or own[0] not in self._headings:
                continue
            first, last = own[0], own[-1]
            driven = _complex(here)[last] - _complex(here)[first]
            marked = self._marked[last] - self._marked[first]
            off = driven * np.exp(-1j * here[first, 2])
            found[run] = off - marked * np.exp(-1j * self._yaw[first])
        return np.stack([found.real, found.imag], axis=1)

    def ends_sd_m(self) -> Array:
        """Return how far from its mark each run may end by what its marks say of themselves [m]."""
        found = np.zeros(len(self.marks))
        found[self._run_of[self._same]] = np.sqrt(2.0) * self._sd_m[self._same]
        for run in range(len(self.marks)):
            own = self._placed[self._run_of[self._placed] == run]
            if len(own) < 2:
                continue
            first, last = own[0], own[-1]
            aside_m = self._yaw_sd[first] * abs(
                self._marked[last] - self._marked[first]
            )
            both_m = np.hypot(self._sd_m[first], self._sd_m[last])
            found[run] = np.hypot(np.sqrt(2.0) * both_m, aside_m)
        return found

    def _of_places(self, poses: Array) -> tuple[Array, Array]:
        """Return by how much absolute marks are missed if each run begins where it fits best."""
        run, of_heading = self._run_of[self._placed], self._run_of[self._headings]
        weight, yaw_weight = (
            sd**-2.0 for sd in (self._sd_m[self._placed], self._yaw_sd[self._headings])
        )
        driven = self._from_middle(_complex(poses)[self._placed])
        marked = self._from_middle(self._marked[self._placed])
        off_yaw = _wrapped(self._yaw - poses[:, 2])[self._headings]

        # a first guess by the headings, or else by the places, and then the least squares of both
        by_heading = self._sums(of_heading, np.exp(1j * off_yaw))
        by_place = self._sums(run, weight * np.conj(driven) * marked)
        yaw = np.angle(np.where(self._headed, by_heading, by_place)) * self._turns
        known = self._sums(run, weight * abs(driven) ** 2).real
        known += self._sums(of_heading, yaw_weight).real
        for _ in range(YAW_STEPS):
            turned = driven * np.exp(1j * yaw[run])
            pull = self._sums(run, weight * (np.conj(turned) * marked).imag).real
            rest = _wrapped(off_yaw - yaw[of_heading])
            pull += self._sums(of_heading, yaw_weight * rest).real
            yaw = yaw + pull / np.maximum(known, 1e-300) * self._turns
        off = marked - driven * np.exp(1j * yaw[run])
        return off, _wrapped(off_yaw - yaw[of_heading])


def _where(marks: Sequence[FloorMark], is_one: Callable[[FloorMark], bool]) -> Indices:
    return np.array([i for i, mark in enumerate(marks) if is_one(mark)], int)


def _complex(poses: Array) -> Array:
    return np.asarray(poses[:, 0] + 1j * poses[:, 1])


def _wrapped(angle: Array | float) -> Array:
    return np.asarray(np.arctan2(np.sin(angle), np.cos(angle)))


def rows_of(runs: MarkedRuns, chosen: Indices) -> Mask:
    """Return which rows belong to some runs."""
    return np.isin(runs.run, chosen)
