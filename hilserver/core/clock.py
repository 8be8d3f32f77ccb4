"""UTC stamps for ticks: an anchor of CLOCK_MONOTONIC in UTC, slewed.

The loop counts on CLOCK_MONOTONIC alone. OPC UA needs UTC; if it were read per value, a step of
the system clock (NTP) would tear the series. The anchor therefore follows UTC slowly.
"""

import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_APART_NS, _TOGETHER_NS = 1_000_000_000, 500_000_000
"""Above the first the clocks count as apart, below the second as together again."""


class UtcClock:
    """Maps CLOCK_MONOTONIC to UTC without steps.

    Parameters
    ----------
    slew_ppm : float
        How fast the anchor follows the system clock: 500 us per second by default, as NTP does.
    simulated : bool
        Virtual mode: the stamps are simulated time and are flagged as such.
    """

    def __init__(
        self,
        *,
        slew_ppm: float = 500.0,
        simulated: bool = False,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
        utc_ns: Callable[[], int] = time.time_ns,
    ) -> None:
        self.simulated = simulated
        self._slew_ppm = slew_ppm
        self._monotonic_ns = monotonic_ns
        self._system_utc_ns = utc_ns
        self._slewed_at_ns = monotonic_ns()
        self._offset_ns = utc_ns() - self._slewed_at_ns
        self._are_apart = False

    def slew(self) -> str | None:
        """Move the anchor towards the system clock; called by the supervise slice.

        Return a notice, once, when the system clock has stepped away, as it does on a computer
        that gets the time only after its start.
        """
        now_ns = self._monotonic_ns()
        error_ns = self._system_utc_ns() - now_ns - self._offset_ns
        limit_ns = int((now_ns - self._slewed_at_ns) * self._slew_ppm * 1e-6)
        self._offset_ns += max(-limit_ns, min(limit_ns, error_ns))
        self._slewed_at_ns = now_ns
        were_apart = self._are_apart
        self._are_apart = abs(self.error_ns) > (
            _TOGETHER_NS if were_apart else _APART_NS
        )
        if self.simulated or were_apart or not self._are_apart:
            return None
        return (
            f"the system clock stepped by {self.error_ns / 1e9:+.1f} s; time stamps follow by"
            f" {self._slew_ppm / 1e3:g} ms a second, a restart takes it over at once"
        )

    @property
    def error_ns(self) -> int:
        """System UTC minus ours [ns]."""
        return self._system_utc_ns() - self._monotonic_ns() - self._offset_ns

    def utc_ns(self, monotonic_ns: int) -> int:
        """Return UTC [ns since 1970] of a CLOCK_MONOTONIC reading."""
        return monotonic_ns + self._offset_ns

    def utc(self, monotonic_ns: int) -> datetime:
        """Return UTC as a datetime (microseconds) of a CLOCK_MONOTONIC reading."""
        return _EPOCH + timedelta(microseconds=self.utc_ns(monotonic_ns) // 1000)
