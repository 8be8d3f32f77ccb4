"""Time slices: periods in whole ticks of the base period.

A slice runs in every tick whose number is a multiple of its period; all slices run in tick 0.
Compiled slices run inside the tick, in the order in which they are given; communication slices run
on the event loop, which a doorbell wakes.
"""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Slice:
    """One time slice."""

    name: str  # unique; used in metrics and log lines
    period_ticks: int  # it runs in every tick that is a multiple of this
    # True: a phase of the compiled step. False: a communication slice on the event loop
    compiled: bool

    def __post_init__(self) -> None:
        if self.period_ticks < 1:
            raise ValueError(
                f"slice {self.name!r}: the period must be at least one tick"
            )


def period_in_ticks(name: str, period_ns: int, base_period_ns: int) -> int:
    """Return the period of slice `name` in ticks.

    ValueError if `period_ns` is not a multiple of `base_period_ns`; it names the nearest two.
    """
    if base_period_ns <= 0:
        raise ValueError("the base period must be positive")
    ticks, rest = divmod(period_ns, base_period_ns)
    if ticks >= 1 and rest == 0:
        return ticks
    if ticks < 1:
        raise ValueError(
            f"slice {name!r}: {_ms(period_ns)} is shorter than the base period; "
            f"the nearest possible are {_ms(base_period_ns)} and {_ms(2 * base_period_ns)}"
        )
    raise ValueError(
        f"slice {name!r}: {_ms(period_ns)} is not a multiple of the base period "
        f"{_ms(base_period_ns)}; the nearest are {_ms(ticks * base_period_ns)} "
        f"and {_ms((ticks + 1) * base_period_ns)}"
    )


def check_slices(slices: Sequence[Slice]) -> tuple[list[Slice], list[Slice]]:
    """Return the compiled and the communication slices, each in the given order."""
    names = [part.name for part in slices]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"slice names must be unique; given twice: {', '.join(twice)}")
    compiled = [part for part in slices if part.compiled]
    if not compiled:
        raise ValueError("at least one compiled slice is needed")
    return compiled, [part for part in slices if not part.compiled]


def _ms(duration_ns: int) -> str:
    """Return a duration as text, exactly, in ms."""
    return (
        f"{duration_ns // 10**6}.{duration_ns % 10**6:06d}".rstrip("0").rstrip(".")
        + " ms"
    )
