"""Clock offset and stamps in virtual time."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilserver.io.peer_link.latency import ClockOffset, StampWatch, one_way_ns

MS = 1_000_000
SECOND = 1_000 * MS


def read(
    offset: ClockOffset, at_ns: int, there_ns: int, back_ns: int, peer_clock
) -> bool:
    """One read that leaves at `at_ns` and is answered `there_ns` later."""
    return offset.read(at_ns, at_ns + there_ns + back_ns, peer_clock(at_ns + there_ns))


@settings(max_examples=200)
@given(
    true_ns=st.integers(-(10**13), 10**13),
    delays=st.lists(
        st.tuples(st.integers(50_000, 9 * MS), st.integers(50_000, 9 * MS)),
        min_size=2,
        max_size=40,
    ),
)
def test_fresh_clock_offset_lies_within_its_uncertainty(true_ns, delays):
    offset, now = ClockOffset(), 10**15
    for there, back in delays:
        read(offset, now, there, back, lambda t: t + true_ns)
        now += there + back + MS
    if offset.offset_ns is not None:
        assert abs(offset.offset_ns - true_ns) <= offset.uncertainty_ns + 1


@settings(max_examples=100)
@given(true_ns=st.integers(-(10**12), 10**12), start_ns=st.integers(0, SECOND))
def test_stepped_clock_is_caught_at_its_step(true_ns, start_ns):
    """asyncua's CurrentTime moves once a second: naive reading would be wrong by up to that."""
    offset, now = ClockOffset(), 10**15 + start_ns

    def clock(t: int) -> int:
        peer = t + true_ns
        return peer - peer % SECOND

    for _ in range(300):
        if read(offset, now, MS, MS, clock):
            break
        now += 5 * MS
    assert abs(offset.offset_ns - true_ns) <= offset.uncertainty_ns
    assert offset.uncertainty_ns < 10 * MS


def test_single_reads_a_second_apart_say_nothing():
    offset = ClockOffset()
    for beat in range(10):
        at = beat * SECOND
        assert not read(offset, at, MS, MS, lambda t: t - t % SECOND + 5 * SECOND)
    assert offset.offset_ns is None


def test_stamps_that_advance_count_and_the_first_does_not():
    watch = StampWatch()
    assert not watch.observe("n", 100, 1.0).advanced
    assert watch.observe("n", 200, 1.0).advanced
    assert not watch.observe("n", 200, 1.0).advanced
    assert not watch.observe("n", None, 1.0).advanced


def test_frozen_stamp_is_named_after_three_changes():
    watch = StampWatch()
    verdicts = [watch.observe("n", 100, float(value)).fault for value in range(5)]
    assert verdicts == [None, None, None, "frozen_stamp", "frozen_stamp"]
    assert watch.observe("n", 101, 9.0).fault is None


def test_one_value_stamped_twice_is_no_fault_but_an_hour_back_is():
    watch = StampWatch()
    watch.observe("n", 10 * SECOND, 1.0)
    assert watch.observe("n", 10 * SECOND - MS, 1.0).fault is None
    assert watch.observe("n", 10 * SECOND - MS, 2.0).fault is None
    assert watch.observe("n", SECOND, 2.0).fault == "stamp_backwards"
    assert watch.observe("n", 2 * SECOND, 2.0).advanced


@pytest.mark.parametrize("offset_ns", [-7 * SECOND, 0, 7 * SECOND])
def test_one_way_is_corrected_by_the_offset(offset_ns):
    sent, arrived = 100 * SECOND, 100 * SECOND + 27 * MS
    assert one_way_ns(sent + offset_ns, arrived, offset_ns) == 27 * MS
