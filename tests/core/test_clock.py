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


def test_stamps_have_microseconds():
    utc = UtcClock(monotonic_ns=lambda: 0, utc_ns=lambda: 1_600_000_000_123_456_789)
    assert utc.utc(1_000).isoformat() == "2020-09-13T12:26:40.123457+00:00"
