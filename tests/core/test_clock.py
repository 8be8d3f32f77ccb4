"""UTC stamps do not tear when the system clock steps."""

import itertools

from hilserver.core.clock import UtcClock
from tests.fakes import ManualClock


def test_a_step_of_the_system_clock_is_followed_slowly():
    clock = ManualClock()
    step_ns = 0
    utc = UtcClock(monotonic_ns=clock, utc_ns=lambda: clock.now_ns + 10**18 + step_ns)
    before = utc.utc_ns(clock.now_ns)
    step_ns = 1_000_000_000
    assert utc.utc_ns(clock.now_ns) == before
    stamps = []
    for _ in range(100):
        clock.pass_s(0.1)
        utc.slew()
        stamps.append(utc.utc_ns(clock.now_ns))
    gaps = {b - a for a, b in itertools.pairwise(stamps)}
    assert gaps == {100_050_000}  # 500 ppm
    assert utc.error_ns == 1_000_000_000 - 100 * 50_000


def test_a_step_is_said_once_and_a_small_one_not_at_all():
    clock, step_s = ManualClock(), 0.0
    utc = UtcClock(
        monotonic_ns=clock, utc_ns=lambda: clock.now_ns + round(step_s * 1e9)
    )
    said = []
    for step_s in (0.0, 0.9, 3600.0, 3600.0, 0.7, 0.0, -5.0):  # noqa: B007 - the lambda reads it
        clock.pass_s(0.1)
        said += [text for _ in range(3) if (text := utc.slew()) is not None]
    assert [text.split(";")[0] for text in said] == [
        "the system clock stepped by +3600.0 s",
        "the system clock stepped by -5.0 s",
    ]
    assert "a restart takes it over at once" in said[0]


def test_in_virtual_time_no_clock_is_spoken_of():
    clock = ManualClock()
    times = iter([0, *[10**12] * 9])
    utc = UtcClock(simulated=True, monotonic_ns=clock, utc_ns=lambda: next(times))
    assert utc.slew() is None


def test_stamps_have_microseconds():
    utc = UtcClock(monotonic_ns=lambda: 0, utc_ns=lambda: 1_600_000_000_123_456_789)
    assert utc.utc(1_000).isoformat() == "2020-09-13T12:26:40.123457+00:00"
