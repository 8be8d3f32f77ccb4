"""Faults of peer links: lanes in turned time, and a real link that is cut, late and lossy."""

import time

from hilserver.faults.links import MAX_QUEUED, Lane, PeerLine
from hilserver.faults.model import parse_fault
from tests.fakes import ManualClock
from tests.helpers.daemons import free_port
from tests.io.opcua_client.conftest import (
    Peer,
    make_harness,
    peer_config,
    wait_until,
)


class Clock(ManualClock):
    def __call__(self):
        return self.now_ns * 1e-9


def lane_with(*faults, direction="in"):
    clock = Clock()
    line = PeerLine("plc", clock)
    for fault in faults:
        line.inject(parse_fault({"peer": "plc"} | fault))
    return line, Lane(line, direction), clock


def travel(lane, clock, n, every_s=0.010):
    """Send n batches, one each `every_s`; return them in order of arrival, with their delay."""
    arrived = []
    for i in range(n):
        lane.put(i)
        for _ in range(10):
            arrived += [
                (batch, round(clock() - 1.0 - batch * every_s, 6))
                for batch in lane.take()
            ]
            clock.pass_s(every_s / 10)
    for _ in range(1000):
        arrived += [
            (batch, round(clock() - 1.0 - batch * every_s, 6)) for batch in lane.take()
        ]
        clock.pass_s(0.001)
    return arrived


def test_without_faults_everything_arrives_at_once():
    _, lane, clock = lane_with()
    assert travel(lane, clock, 20) == [(i, 0.0) for i in range(20)]


def test_delay_is_the_same_for_all():
    _, lane, clock = lane_with({"fault": "delay", "delay_s": 0.050})
    found = travel(lane, clock, 20)
    assert [batch for batch, _ in found] == list(range(20))
    assert all(0.050 <= late <= 0.0511 for _, late in found)


def test_jitter_keeps_the_order():
    _, lane, clock = lane_with(
        {"fault": "jitter", "delay_s": 0.020, "jitter_s": 0.060, "seed": 4}
    )
    found = travel(lane, clock, 50)
    assert [batch for batch, _ in found] == list(range(50))
    assert len({late for _, late in found}) > 10
    assert all(0.020 <= late <= 0.0811 for _, late in found)


def test_reorder_lets_some_overtake():
    _, lane, clock = lane_with(
        {"fault": "reorder", "probability": 0.3, "delay_s": 0.035, "seed": 1}
    )
    found = [batch for batch, _ in travel(lane, clock, 50)]
    assert sorted(found) == list(range(50))
    assert found != sorted(found)


def test_drop_loses_its_share_and_counts():
    line, lane, clock = lane_with({"fault": "drop", "probability": 0.4, "seed": 2})
    found = travel(lane, clock, 200)
    assert 80 <= len(found) <= 160
    assert line.lost == 200 - len(found)


def test_a_direction_and_a_time_limit_it():
    _, lane, clock = lane_with({"fault": "drop", "probability": 1, "direction": "out"})
    assert len(travel(lane, clock, 5)) == 5
    line, lane, clock = lane_with(
        {"fault": "drop", "probability": 1, "from_s": 0.1, "for_s": 0.1}
    )
    assert [batch for batch, _ in travel(lane, clock, 30)] == [
        *range(10),
        *range(20, 30),
    ]
    assert line.active() == []


def test_the_queue_is_bounded():
    line, lane, _ = lane_with({"fault": "delay", "delay_s": 1000})
    for i in range(MAX_QUEUED + 7):
        lane.put(i)
    assert len(lane) == MAX_QUEUED
    assert line.overflowed == 7


async def test_a_real_link_is_cut_comes_back_and_is_late():
    peer = await Peer(free_port()).start()
    line = PeerLine("iot2050")
    harness = make_harness(peer_config(peer.port), line=line)
    await harness.link.start()
    try:
        await peer.cycle(rpm_set_FL=1.0)
        await wait_until(
            lambda: harness.gate.latest.get("wheel.fl.setpoint_rpm") == 1.0
        )
        line.inject(parse_fault({"fault": "disconnect", "peer": "iot2050"}))
        await wait_until(lambda: not harness.status.connected)
        assert harness.status.last_error == "an injected fault cut the link"
        failed = harness.status.failed_attempts
        await wait_until(lambda: harness.stale != [])
        assert (harness.status.connected, harness.status.failed_attempts) == (
            False,
            failed,
        )
        line.clear()
        await wait_until(lambda: harness.status.connected)
        line.inject(parse_fault({"fault": "delay", "peer": "iot2050", "delay_s": 0.4}))
        sent_s = time.monotonic()
        await peer.cycle(rpm_set_FL=2.0)
        await wait_until(
            lambda: harness.gate.latest.get("wheel.fl.setpoint_rpm") == 2.0
        )
        assert time.monotonic() - sent_s >= 0.4
    finally:
        await harness.link.stop()
        await peer.stop()
