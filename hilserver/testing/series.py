"""Recorded signals, and the bands in which they have to stay."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilserver.arrays import Array

__tracebackhide__ = True  # pytest then shows the failing line of the test
Reference = float | Array | Callable[[Array], Array]


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """One signal over simulated time."""

    name: str
    unit: str
    time_s: Array  # shape (n,); simulated time of each sample [s]
    tick: NDArray[np.int64]  # shape (n,)
    values: Array  # shape (n,); in `unit`

    def __len__(self) -> int:
        return len(self.values)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.array(self.values, dtype=dtype, copy=copy)

    @property
    def last(self) -> float:
        """Newest value."""
        self._need_samples()
        return float(self.values[-1])

    def between(
        self, from_s: float | None = None, to_s: float | None = None
    ) -> "Series":
        """Return the part from `from_s` to `to_s`, both counted from the first sample [s]."""
        age_s = self._age_s(up_to_s=to_s)
        keep = np.ones(len(self), dtype=bool)
        if from_s is not None:
            keep &= age_s >= from_s
        if to_s is not None:
            keep &= age_s <= to_s
        if not keep.any():
            raise AssertionError(
                f"{self.name}: no sample between {from_s} s and {to_s} s; it is"
                f" {age_s[-1]:.3f} s long"
            )
        return Series(
            self.name, self.unit, self.time_s[keep], self.tick[keep], self.values[keep]
        )

    def assert_within(
        self,
        low: float | None = None,
        high: float | None = None,
        *,
        from_s: float | None = None,
        to_s: float | None = None,
    ) -> None:
        """Fail at the first sample below `low` or above `high`."""
        if low is None and high is None:
            raise AssertionError(
                f"{self.name}: give low, high or both, else every value is within"
            )
        part = self.between(from_s, to_s)
        lows = -np.inf if low is None else low
        highs = np.inf if high is None else high
        one_end = f"fell below {lows:g}" if high is None else f"rose above {highs:g}"
        what = one_end if low is None or high is None else f"left {lows:g} .. {highs:g}"
        part._fail_where(~((part.values >= lows) & (part.values <= highs)), what)

    def assert_near(
        self,
        reference: Reference,
        tolerance: float,
        *,
        from_s: float | None = None,
        to_s: float | None = None,
    ) -> None:
        """Fail at the first sample farther than `tolerance` from `reference`.

        Parameters
        ----------
        reference : float, ndarray or callable
            A number, one value for each sample of the part, or a function of its times counted
            from the first sample of the series [s].
        """
        part = self.between(from_s, to_s)
        if callable(reference):
            reference = reference(part.time_s - self.time_s[0])
        if np.ndim(reference) and np.shape(reference) != part.values.shape:
            raise AssertionError(
                f"{self.name}: the reference has the shape {np.shape(reference)}, the part of the"
                f" capture {part.values.shape}; give one value for each sample"
            )
        distance = np.abs(part.values - reference)
        part._fail_where(
            ~(distance <= tolerance), f"left the reference +- {tolerance:g}"
        )

    def settle_time_s(self, target: float, tolerance: float) -> float | None:
        """Return the time after which it stays within `tolerance` of `target` [s]; None: never."""
        self._need_samples()
        outside = np.flatnonzero(~(np.abs(self.values - target) <= tolerance))
        if outside.size == 0:
            return 0.0
        if outside[-1] == len(self) - 1:
            return None
        return float(self.time_s[outside[-1] + 1] - self.time_s[0])

    def assert_settles(
        self, target: float, tolerance: float, *, within_s: float
    ) -> None:
        """Fail if it does not stay within `tolerance` of `target` after `within_s` [s]."""
        found_s = self.settle_time_s(target, tolerance)
        wanted = f"{target:g} +- {tolerance:g} {self.unit} within {within_s:g} s"
        if found_s is None:
            raise AssertionError(
                f"{self.name} does not settle at {wanted}: it ends at {self.last:g} {self.unit}"
            )
        if found_s > within_s:
            raise AssertionError(
                f"{self.name} settles at {wanted} only after {found_s:.3f} s"
            )
        self._age_s(up_to_s=within_s)

    def overshoot(self, target: float) -> float:
        """Return how far it goes beyond `target`, as a share of the step from its first value."""
        self._need_samples()
        step = target - self.values[0]
        if step == 0.0:
            raise AssertionError(
                f"{self.name} starts at {target:g}: there is no step to overshoot"
            )
        return float(max(0.0, np.max((self.values - target) / step)))

    def assert_overshoot(self, target: float, *, at_most: float) -> None:
        """Fail if the overshoot is larger than the share `at_most`."""
        found = self.overshoot(target)
        if not found <= at_most:
            raise AssertionError(
                f"{self.name} overshoots {target:g} {self.unit} by {found:.1%},"
                f" allowed are {at_most:.1%}"
            )

    def _need_samples(self) -> None:
        if len(self) == 0:
            raise AssertionError(
                f"{self.name}: nothing was captured; step inside the capture"
            )

    def _age_s(self, *, up_to_s: float | None) -> Array:
        """Return the times since the first sample [s], shape (n,), if they reach that far.

        What was not captured could be anything: a band is not kept there.
        """
        self._need_samples()
        age_s: Array = self.time_s - self.time_s[0]
        period_s = age_s[1] if len(age_s) > 1 else 0.0
        if up_to_s is not None and up_to_s > age_s[-1] + 1.5 * period_s:
            raise AssertionError(
                f"{self.name}: the capture ends after {age_s[-1]:.3f} s and is to be judged until"
                f" {up_to_s:g} s; step further inside the capture"
            )
        return age_s

    def _fail_where(self, wrong: NDArray[np.bool_], what: str) -> None:
        if not wrong.any():
            return
        at = int(np.argmax(wrong))
        raise AssertionError(
            f"{self.name} {what} {self.unit}: {self.values[at]:g} at {self.time_s[at]:.3f} s"
            f" (tick {self.tick[at]}), {int(wrong.sum())} of {len(self)} samples are outside"
        )


def assert_within(
    series: Series, low: float | None = None, high: float | None = None
) -> None:
    """Fail at the first sample of `series` below `low` or above `high`."""
    series.assert_within(low, high)
