"""The way in of a link: what is read after a standstill of ours may be as old as that."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilserver.config.section import Driver
from hilserver.core.events import EventBus
from hilserver.io.arrival import LEFT_OVER_NS, WATCH_NS
from hilserver.io.link_status import PeerStatus
from hilserver.io.source import Source
from tests.fakes import make_gate, make_image, make_table

MS = 1_000_000
LIMIT_MS, WATCH_MS = 250, 20
DRIVER = Driver("plc", "peer:plc", "the PLC", LIMIT_MS, "zero")


def watched(until_ms, *, limit_ms=LIMIT_MS, has_written=True, is_exact=False):
    """Return a source that has been looked at from 1 s on."""
    events, table = EventBus(), make_table()
    gate = make_gate(table, make_image(table), events)
    status = PeerStatus("plc")
    driver = DRIVER._replace(limit_ms=limit_ms)
    source = Source(
        driver,
        "PLC",
        status,
        gate,
        events.publish,
        fresh=lambda: "fresh",
        is_exact=is_exact,
    )
    if has_written:
        source.write({}, 1000 * MS)
    for at_ms in range(1000, until_ms, WATCH_MS):
        source.watch(at_ms * MS)
    return source


def test_what_is_read_in_time_came_in_now():
    source = watched(2000)
    assert source.came_ns(2000 * MS) == 2000 * MS
    assert source.came_ns((1980 + LIMIT_MS) * MS) == (1980 + LIMIT_MS) * MS


def test_what_is_read_behind_a_standstill_may_be_as_old_as_that():
    source = watched(2001)
    stood, back = 2000 * MS, 7000 * MS
    assert source.came_ns(back) == stood
    source.watch(back + MS)
    assert source.came_ns(back + LEFT_OVER_NS) == stood, "what is under way comes later"


def test_it_does_not_matter_who_notices_the_standstill():
    source = watched(2001)
    source.watch(7000 * MS)
    assert source.came_ns(7001 * MS) == 2000 * MS


@pytest.mark.parametrize("stood_s", [1, 30])
def test_the_longer_it_stood_the_longer_what_has_waited_is_read(stood_s):
    source = watched(2001)
    back = (2000 + 1000 * stood_s) * MS
    until = back + max(LEFT_OVER_NS, stood_s * 100 * MS)
    assert source.came_ns(back) == 2000 * MS
    for at in range(back, until, WATCH_NS):
        source.watch(at)
    assert source.came_ns(until - 1) == 2000 * MS
    assert source.came_ns(until) == until


@pytest.mark.parametrize("limit_ms", [50, 500])
@given(
    phase=st.integers(0, 99),
    every=st.integers(7, 100),
    late=st.lists(st.integers(0, 100), min_size=5, max_size=20),
)
def test_whoever_watches_in_time_never_stands_still(limit_ms, phase, every, late):
    """Each look is late by up to the limit (`late` in percent); writes come at a rate of theirs."""
    source, at = watched(2001, limit_ms=limit_ms), 2000 * MS
    write = at + phase * MS
    for percent in late:
        at += WATCH_NS + limit_ms * MS * percent // 100
        while write <= at:
            assert source.came_ns(write) == write
            write += every * MS
        source.watch(at)


def test_a_late_look_is_forgotten_with_the_next():
    source = watched(2001, limit_ms=50)
    back = 2075 * MS
    assert source.came_ns(back) == 2000 * MS
    for at in range(back + 5 * MS, back + LEFT_OVER_NS, WATCH_NS):
        source.watch(at)
    for at in range(back + LEFT_OVER_NS, back + 10 * LEFT_OVER_NS, WATCH_NS):
        source.watch(at)
        assert source.came_ns(at + WATCH_NS - 1) == at + WATCH_NS - 1


def test_what_is_written_before_the_first_look_came_in_now():
    source = watched(1000)
    assert source.came_ns(9000 * MS) == 9000 * MS


def test_a_time_that_is_exact_stays():
    source = watched(2001, is_exact=True)
    assert source.came_ns(6000 * MS) == 6000 * MS
    source.watch(7000 * MS)
    assert source.came_ns(7001 * MS) == 7001 * MS


def test_a_command_is_handed_on_with_when_it_came(monkeypatch):
    source, came, received = watched(2001), [], []

    def noting(_source, _values, *, received_ns, commanded_ns, **_):
        came.append(commanded_ns)
        received.append(received_ns)
        return {}

    monkeypatch.setattr(source._gate, "write", noting)
    for at_ms in (2000, 2500, 2700):
        source.write({}, at_ms * MS)
    assert came == [2000 * MS, 2000 * MS, 2700 * MS]
    assert received == [2000 * MS, 2500 * MS, 2700 * MS], (
        "when a sample was taken is another thing"
    )


def test_the_first_command_of_all_is_none_that_is_left_over():
    source = watched(2001, has_written=False)
    assert source.came_ns(7000 * MS) == 7000 * MS
