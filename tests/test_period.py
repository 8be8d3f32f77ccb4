"""Periods whose timers are early, late or doubled, in virtual time."""

import itertools
from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilserver.period import Period

PERIOD_S = 0.1


class Loop:
    """A loop whose timers fire off their time by what the test says."""

    def __init__(self, errors_s: list[float], fires: int = 1) -> None:
        self.now_s, self._errors_s, self._fires = 10.0, itertools.cycle(errors_s), fires
        self._timers: dict[int, tuple[float, Callable[[], None]]] = {}
        self._number = itertools.count()

    def clock(self) -> float:
        return self.now_s

    def call_later(self, delay_s: float, call: Callable[[], None]) -> "Timer":
        number = next(self._number)
        due_s = self.now_s + max(0.0, delay_s + next(self._errors_s))
        self._timers[number] = (due_s, call)
        return Timer(self._timers, number)

    def run(self, until_s: float) -> None:
        for _ in range(100_000):
            if not self._timers:
                return
            number = min(self._timers, key=lambda n: self._timers[n][0])
            due_s, call = self._timers[number]
            if due_s > until_s:
                return
            del self._timers[number]
            self.now_s = max(self.now_s, due_s)
            for _ in range(self._fires):
                call()
        raise AssertionError("turns without rest")


class Timer:
    def __init__(self, timers: dict, number: int) -> None:
        self._timers, self._number = timers, number

    def cancel(self) -> None:
        self._timers.pop(self._number, None)


def calls(loop: Loop, periods: int = 20) -> list[float]:
    """Return when the calls came, in periods from the start."""
    found: list[float] = []
    period = Period(lambda: found.append(loop.now_s), loop.clock, loop.call_later)
    period.start(PERIOD_S, PERIOD_S)
    loop.run(10.0 + (periods + 0.9) * PERIOD_S)
    return [(at_s - 10.0) / PERIOD_S for at_s in found]


@pytest.mark.parametrize("fires", [1, 2])
@pytest.mark.parametrize("error_s", [0.0, -0.0003, -0.001, 0.004])
def test_early_late_and_doubled_timers_call_once_in_every_period(
    error_s: float, fires: int
) -> None:
    found = calls(Loop([error_s], fires))
    assert [int(at + 1e-9) for at in found] == list(range(1, 21))
    assert all(at % 1 < 0.06 or at % 1 > 1 - 1e-9 for at in found)


def test_what_a_late_timer_missed_is_not_made_up_for() -> None:
    found = calls(Loop([0.0, 0.0, 3.5 * PERIOD_S, *[0.0] * 100]))
    assert found == pytest.approx([1, 2, 6.5, *range(7, 21)], abs=0.02)


@given(st.lists(st.floats(-0.001, 0.35), min_size=1, max_size=30), st.integers(1, 2))
def test_never_early_never_twice_in_a_period_and_never_silent(
    errors_s: list[float], fires: int
) -> None:
    found = calls(Loop(errors_s, fires))
    periods = [int(at + 1e-9) for at in found]
    assert periods == sorted(set(periods))
    assert min(periods) >= 1
    assert max(b - a for a, b in itertools.pairwise([0, *periods, 21])) <= 5


def test_stopped_and_started_anew() -> None:
    found: list[float] = []
    loop = Loop([0.0])
    period = Period(lambda: found.append(loop.now_s), loop.clock, loop.call_later)
    period.start(1.0, 0.0)
    period.stop()
    assert not period.is_running
    loop.run(20.0)
    assert not found
    period.start(1.0, 0.5)
    period.start(2.0, 1.0)
    assert period.is_running
    loop.run(14.0)
    assert found == pytest.approx([11.0, 13.0], abs=0.002)
