"""Our link against the real peer: the shipped flow, a plain one and a lying one."""

import json
import statistics

import pytest

from hilserver.config.peers import PeerConfig
from hilserver.controller.nodes import SENSORS, demo_peer
from hilserver.io.link_status import PeerStatus
from tests.io.opcua_client.conftest import make_harness, wait_until
from tests.node_red.node_red import shipped_flow, test_flow, with_sink

pytestmark = pytest.mark.node_red

PLAIN_READ = {
    f"ns=1;s=AGV.rpm_set_{wheel}": f"wheel.{wheel.lower()}.setpoint_rpm"
    for wheel in ("FL", "RL", "FR", "RR")
}


def plain_peer(endpoint: str) -> PeerConfig:
    return PeerConfig(
        name="iot2050",
        endpoint=endpoint,
        read=PLAIN_READ,
        sequence_node="ns=1;s=AGV.seq",
        stale_after_ms=500,
    )


async def sequence_of(status: PeerStatus, least: int) -> tuple[int, int]:
    """Wait until `least` more sequence numbers have come; return how many came and were missed."""
    received, missed = status.sequence_received, status.sequence_missed
    await wait_until(lambda: status.sequence_received >= received + least)
    return status.sequence_received - received, status.sequence_missed - missed


async def test_shipped_flow(node_red, tmp_path):
    sink = tmp_path / "sensors.jsonl"
    peer = await node_red(with_sink(shipped_flow(), sink)).start()
    harness = make_harness(demo_peer(peer.endpoint, name="iot2050"))
    for index, signal in enumerate(SENSORS.values()):
        harness.outputs[signal] = (index + 0.5, 0)
    await harness.link.start()
    status = harness.status
    try:
        await wait_until(lambda: not status.stale)
        status.one_way.clear()
        received, missed = await sequence_of(status, 200)
        assert status.mode == "subscribe"
        assert status.granted_publishing_ms == 50
        assert missed <= 0.5 * (received + missed)
        await wait_until(lambda: status.one_way.count >= 100)
        assert harness.gate.all_finite
        assert harness.gate.latest["drive.enable"] is True
        assert (
            harness.gate.latest["wheel.fl.setpoint_rpm"]
            > 0
            > harness.gate.latest["wheel.fr.setpoint_rpm"]
        )
        assert status.faults == {}
    finally:
        await harness.link.stop()
    seen = {}
    for line in sink.read_text().splitlines():
        topic, value, _ = json.loads(line)
        seen.setdefault(topic, []).append(value)
    assert {name: values[-1] for name, values in seen.items()} == {
        name: index + 0.5 for index, name in enumerate(SENSORS)
    }
    assert statistics.median(len(values) for values in seen.values()) >= 5


async def test_plain_flow_is_polled(node_red):
    peer = await node_red(test_flow("plain")).start()
    harness = make_harness(plain_peer(peer.endpoint))
    await harness.link.start()
    status = harness.status
    try:
        await wait_until(lambda: status.mode == "poll" and not status.stale)
        assert status.granted_sampling_ms == 500
        assert harness.heard(
            "the peer samples every 500 ms: polling every 10 ms instead"
        )
        received, missed = await sequence_of(status, 200)
        # Of what changes every 20 ms a subscription sampled every 500 ms misses 96 %; a busy
        # computer makes a poll late now and then.
        assert missed < 0.5 * (received + missed)
    finally:
        await harness.link.stop()


async def test_lying_flow_is_named(node_red):
    peer = await node_red(test_flow("lying")).start()
    harness = make_harness(plain_peer(peer.endpoint))
    await harness.link.start()
    status = harness.status
    try:
        await wait_until(
            lambda: status.mode == "poll" and status.sequence_received > 200
        )
        kinds = {key.split(":")[0] for key in status.faults}
        assert {"frozen_stamp", "not_finite"} <= kinds
        assert status.one_way.count == 0
        assert harness.gate.all_finite
        assert harness.heard("AGV.rpm_set_RR: nan with status Good")
        assert harness.heard(
            "the SourceTimestamp of ns=1;s=AGV.rpm_set_FL stands still"
        )
    finally:
        await harness.link.stop()
