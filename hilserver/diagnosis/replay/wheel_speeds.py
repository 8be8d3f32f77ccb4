"""The wheels between their samples: speed at every tick, and the angle that results from it."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Final

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import uniform_filter1d

from hilserver.arrays import Array
from hilserver.diagnosis.replay.counts import is_counted, smoothed, stiffness
from hilserver.diagnosis.replay.encoders import Driven
from hilserver.diagnosis.thresholds import FEWEST_SAMPLES
from hilserver.measured.channels import SPEEDS
from hilserver.measured.clock import Segments
from hilserver.measured.data import MeasuredLog
from hilserver.measured.resolution import step_of
from hilserver.plant.units import RAD_S_PER_RPM

GOES_ON_S: Final = 0.11
"""Largest time between the last row of a segment and the first one of the next."""
MARGIN_S: Final = 1.0
STEADY_WINDOW_S: Final = 0.4
NOISE_MEMORY: Final = 0.15
NO_SAMPLES: Final = (np.zeros(0), np.zeros(0))
PAIRS: Final = ((0, 1), (2, 3))


@dataclass(frozen=True)
class WheelSpeeds:
    """Measured wheel speeds, on the ticks of some segments."""

    log: MeasuredLog
    segments: Segments  # pieces of the log's spans
    drive: Driven | None  # stage of the drive and its simulated wheels

    @cached_property
    def _joined(self) -> list[list[int]]:
        return neighbours(self.log)

    @cached_property
    def _steps(self) -> list[float]:
        return [
            step_of(self.log[n].values)[0] if n in self.log else 0.0 for n in SPEEDS
        ]

    @cached_property
    def _stiff(self) -> list[float | None]:
        """By wheel: how stiff the curve through its counts is; None if it shows no counts."""
        found: list[float | None] = [None] * len(SPEEDS)
        for wheel, name in enumerate(SPEEDS):
            spans = range(len(self.log.spans)) if name in self.log else ()
            parts = [self.log[name].of(span) for span in spans]
            t_s, speed = max(parts, key=lambda part: len(part[0]), default=NO_SAMPLES)
            if len(t_s) >= FEWEST_SAMPLES and is_counted(t_s, speed):
                found[wheel] = stiffness(t_s, speed)
        return found

    def sides(self) -> tuple[Array, Array]:
        """Return dense sums of both sides' wheel speeds [rpm]."""
        left, right = (
            sum(self.shares[w] for w in side if w in self.shares) for side in PAIRS
        )
        return np.ascontiguousarray(left), np.ascontiguousarray(right)

    def apart(self) -> Array:
        """Return dense front minus rear wheel of both sides [rpm], shape (2, ticks)."""
        return np.stack(
            [self._wheel(front) - self._wheel(rear) for front, rear in PAIRS]
        )

    @cached_property
    def shares(self) -> dict[int, Array]:
        """By wheel: its part of the sum of its side; none if unmeasured beside a measured one."""
        chosen = [
            [w for w in side if SPEEDS[w] in self.log] or list(side) for side in PAIRS
        ]
        return {w: 2.0 / len(side) * self._wheel(w) for side in chosen for w in side}

    def _wheel(self, wheel: int) -> Array:
        """Return one wheel's speed at every tick.

        The model of the closed loop interpolates: simulated speed plus the interpolated difference
        to the measured one, of whose noise only the slow part is used. Encoders may be late or have
        steps, so the difference is to what they would show of the simulated wheels. Without
        set-points a smooth curve goes through the samples, or what was counted by them.
        """
        dense = np.zeros(self.segments.ticks)
        for i in range(len(self.segments)):
            part = slice(int(self.segments.first[i]), int(self.segments.first[i + 1]))
            dense[part] = self._stretch(i, wheel)
        return dense

    def _stretch(self, i: int, wheel: int) -> Array:
        times, span = self.segments.times(i), int(self.segments.span[i])
        t, v = self._samples(
            SPEEDS[wheel], span, times[0] - MARGIN_S, times[-1] + MARGIN_S
        )
        if self.drive is None:
            if len(t) < 2:
                return np.full(len(times), v[0] if len(v) else 0.0)
            stiff = self._stiff[wheel]
            if stiff is not None and len(t) >= FEWEST_SAMPLES:
                return smoothed(t, v, stiff, times)
            inside = np.clip(times, t[0], t[-1])
            return np.asarray(PchipInterpolator(t, v)(inside))
        stage, speed, shown = self.drive
        own = int(np.flatnonzero(stage.segments.span == span)[0])
        part = slice(int(stage.segments.first[own]), int(stage.segments.first[own + 1]))
        simulated = speed[part, wheel]
        start_s, last = float(stage.segments.start_s[own]), len(simulated) - 1
        model = _read(simulated, (times - start_s) / stage.segments.period_s, last)
        if len(t) == 0:
            return np.asarray(model)
        at_samples = _read(
            shown[part, wheel], (t - start_s) / stage.segments.period_s, last
        )
        difference = beyond_rounding(v - at_samples, self._steps[wheel])
        return np.asarray(model + np.interp(times, t, steadied(t, difference)))

    def _samples(
        self, name: str, span: int, start_s: float, end_s: float
    ) -> tuple[Array, Array]:
        if name not in self.log:
            return np.zeros(0), np.zeros(0)
        pieces = [self.log[name].of(s) for s in self._joined[span]]
        t, v = (np.concatenate(column) for column in zip(*pieces, strict=True))
        low, high = np.searchsorted(t, [start_s, end_s])
        return t[low:high], v[low:high]


def angles_at_starts(left: Array, segments: Segments) -> Array:
    """Return the left wheels' angle at the start of each segment, counted over the span."""
    angle = np.zeros(len(segments))
    step = 0.5 * RAD_S_PER_RPM * segments.period_s
    lead, rows = round(segments.lead_s / segments.period_s), segments.first
    for i in range(len(segments)):
        if i and segments.span[i] == segments.span[i - 1]:
            first, end = int(rows[i - 1]), int(rows[i])
            steps = (segments.start_s[i] - segments.start_s[i - 1]) / segments.period_s
            n = min(int(steps), end - first - 1)
            # part of a step counts, too: rounded, it would add up to a drift of the phase
            whole = float(left[first : first + n].sum())
            turned = (whole + (steps - n) * float(left[first + n])) * step
            angle[i] = angle[i - 1] + turned
        else:
            angle[i] = -left[rows[i] : rows[i] + lead].sum() * step
    return angle


def neighbours(log: MeasuredLog) -> list[list[int]]:
    """Return each span with the adjacent ones in which the same drive continues.

    Only spans of one block count: between blocks time runs on, but the drive does not.
    """
    spans = log.spans
    joined = [
        a.block is not None
        and a.block == b.block
        and -1e-9 <= b.start_s - a.end_s <= GOES_ON_S
        for a, b in pairwise(spans)
    ]
    out = []
    for i in range(len(spans)):
        first = i - 1 if i and joined[i - 1] else i
        last = i + 1 if i < len(joined) and joined[i] else i
        out.append(list(range(first, last + 1)))
    return out


def beyond_rounding(difference: Array, step: float) -> Array:
    """Return the part of a difference that rounding does not explain: beyond half a step.

    Rounding stays as long as a wheel keeps its speed, and would turn a robot that drives straight.
    """
    return np.asarray(
        np.sign(difference) * np.maximum(np.abs(difference) - 0.5 * step, 0.0)
    )


def steadied(t_s: Array, difference: Array) -> Array:
    """Return the slow part of what the drive's model leaves, if the rest of it is noise.

    An encoder's noise in the speeds would cause turns and distances of its own. A cause that only
    shifts them between the samples, or removes them while the robot does not turn, would explain
    them. What has a memory is not noise, and is kept.
    """
    n = (
        round(STEADY_WINDOW_S * (len(t_s) - 1) / max(float(np.ptp(t_s)), 1e-9))
        if len(t_s)
        else 0
    )
    if n < 3 or len(t_s) < 2 * n:
        return difference
    swing = difference - difference.mean()
    power = float(swing @ swing)
    for lag in (1, 2, 3, 5):
        if abs(float(swing[lag:] @ swing[:-lag])) > NOISE_MEMORY * power:
            return difference
    return np.asarray(uniform_filter1d(difference, n, mode="nearest"))


def _read(dense: Array, at: Array, last: int) -> Array:
    """Read a dense array between its rows, constant beyond its ends."""
    at = np.clip(at, 0.0, last)
    low = np.minimum(at.astype(np.int64), max(last - 1, 0))
    return np.asarray(
        dense[low] + (at - low) * (dense[np.minimum(low + 1, last)] - dense[low])
    )
