"""The way in of a link: what is read after a standstill of ours may be as old as that."""

from hilserver.config.section import Driver
from hilserver.core.events import EventBus
from hilserver.io.link_status import PeerStatus
from hilserver.io.source import LEFT_OVER_NS, Source
from tests.fakes import make_gate, make_image, make_table

MS = 1_000_000
LIMIT_MS, WATCH_MS = 250, 20
DRIVER = Driver("plc", "peer:plc", "the PLC", LIMIT_MS, "zero")


def watched(until_ms, *, every_ms=WATCH_MS, in_real_time=True, has_written=True):
    """Return a source that has been looked at from 1 s on."""
    events, table = EventBus(), make_table()
    gate = make_gate(table, make_image(table), events, in_real_time=in_real_time)
    status = PeerStatus("plc")
    source = Source(DRIVER, "PLC", status, gate, events.publish, fresh=lambda: "fresh")
    if has_written:
        source.write({}, 1000 * MS)
    for at_ms in range(1000, until_ms, every_ms):
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
    assert source.came_ns(back + LEFT_OVER_NS - 1) == stood, "what is under way comes later"
    assert source.came_ns(back + LEFT_OVER_NS) == back + LEFT_OVER_NS


def test_it_does_not_matter_who_notices_the_standstill():
    source = watched(2001)
    source.watch(7000 * MS)
    assert source.came_ns(7001 * MS) == 2000 * MS


def test_who_looks_seldom_does_not_stand_still():
    source = watched(9001, every_ms=1000)
    assert source.came_ns(9900 * MS) == 9900 * MS
    assert source.came_ns(15_000 * MS) == 9000 * MS
    for at_ms in range(16_000, 20_000, 1000):
        source.watch(at_ms * MS)
    assert source.came_ns(19_900 * MS) == 19_900 * MS


def test_simulated_time_does_not_pass_meanwhile():
    assert watched(2001, in_real_time=False).came_ns(7000 * MS) == 7000 * MS


def test_a_command_is_handed_on_with_when_it_came(monkeypatch):
    source, came = watched(2001), []

    def noting(_source, _values, *, received_ns, **_):
        came.append(received_ns)
        return {}

    monkeypatch.setattr(source._gate, "write", noting)
    for at_ms in (2000, 7000, 7200):
        source.write({}, at_ms * MS)
    assert came == [2000 * MS, 2000 * MS, 7200 * MS]


def test_the_first_command_of_all_is_none_that_is_left_over():
    source = watched(2001, has_written=False)
    assert source.came_ns(7000 * MS) == 7000 * MS
