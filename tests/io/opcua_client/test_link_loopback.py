"""The link against a real server in this process: what arrives, what is refused, what is told."""

import asyncio
import contextlib
from datetime import UTC, datetime

import pytest
from asyncua import ua

from hilserver.core.refusal import Refusal
from hilserver.faults import PeerLine
from hilserver.faults.model import parse_fault
from hilserver.plant.layout import WHEELS
from tests.helpers.daemons import free_port
from tests.io.opcua_client.conftest import (
    URI,
    Harness,
    Peer,
    make_harness,
    peer_config,
    wait_until,
)

pytestmark = pytest.mark.asyncio(loop_scope="module")
LIMIT_S = 60.0


@contextlib.asynccontextmanager
async def running(harness: Harness, peer: Peer | None = None):
    await harness.link.start()
    task = asyncio.create_task(peer.run()) if peer else None
    try:
        yield harness
    finally:
        if task:
            task.cancel()
        await harness.link.stop()


@pytest.mark.parametrize("mode", ["subscribe", "poll", "auto"])
async def test_setpoints_and_sequence_arrive(peer, mode):
    harness = make_harness(peer_config(peer.port, mode=mode))
    async with running(harness, peer):
        await wait_until(lambda: harness.status.sequence_received >= 25)
        assert harness.status.mode == ("poll" if mode == "poll" else "subscribe")
        # Polling sees what stands there when it comes; a busy computer lets it come late.
        assert mode == "poll" or harness.status.sequence_missed == 0
        assert not harness.status.stale
        assert harness.status.faults == {}
    speeds = harness.gate.values("wheel.fl.setpoint_rpm")
    assert len(set(speeds)) >= 5
    assert harness.gate.values("input.sequence")[-1] > 20
    assert set(harness.gate.latest) >= {f"wheel.{w}.setpoint_rpm" for w in WHEELS}
    assert harness.status.state == "stopped"


async def test_granted_intervals_are_read_back(peer):
    harness = make_harness(peer_config(peer.port, publishing_ms=40))
    async with running(harness):
        await wait_until(lambda: harness.status.granted_sampling_ms is not None)
        assert harness.status.granted_publishing_ms == 40


async def test_round_trip_offset_and_one_way_are_measured(peer):
    harness = make_harness(peer_config(peer.port, mode="poll"))
    async with running(harness, peer):
        await wait_until(lambda: harness.status.one_way.count > 20)
        assert harness.status.round_trip.count > 2
        # One clock on both sides; asyncua's CurrentTime steps by a second, which must not show.
        assert abs(harness.status.clock_offset_s) < 0.1
        assert harness.status.interval.count > 20


@pytest.mark.parametrize("mode", ["subscribe", "poll"])
@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
async def test_a_lying_peer_is_named_and_never_reaches_the_gate(peer, mode, bad):
    harness = make_harness(peer_config(peer.port, mode=mode))
    async with running(harness, peer):
        await wait_until(lambda: not harness.status.stale)
        await peer.set("rpm_set_RR", bad)
        await wait_until(
            lambda: any("rpm_set_RR" in key for key in harness.status.faults)
        )
        await wait_until(lambda: harness.stale == ["peer:iot2050"])
        await peer.set("rpm_set_RR", 1.0)
        await wait_until(lambda: harness.restored == ["iot2050"])
    assert harness.gate.all_finite
    assert harness.heard("rpm_set_RR")


@pytest.mark.parametrize("mode", ["subscribe", "poll"])
async def test_text_in_a_number_is_named(peer, mode):
    read = {f"nsu={URI};s=label": "wheel.rr.setpoint_rpm"}
    harness = make_harness(peer_config(peer.port, mode=mode, read=read))
    async with running(harness, peer):
        await peer.set("label", "12.5")
        await wait_until(lambda: harness.heard("str '12.5' with status Good"))
        assert any(key.startswith("text_in_number") for key in harness.status.faults)
    assert harness.gate.values("wheel.rr.setpoint_rpm") == []


async def test_bad_status_is_not_used(peer):
    harness = make_harness(peer_config(peer.port))
    async with running(harness, peer):
        await wait_until(lambda: not harness.status.stale)
        await peer.set("rpm_set_RL", 33.0, status=ua.StatusCodes.BadSensorFailure)
        await wait_until(lambda: harness.heard("BadSensorFailure"))
    assert 33.0 not in harness.gate.values("wheel.rl.setpoint_rpm")


async def test_frozen_source_stamps_give_no_latency(peer):
    harness = make_harness(peer_config(peer.port, mode="poll"))
    frozen = datetime(2020, 1, 1, tzinfo=UTC)
    async with running(harness):
        for number in range(40):
            await peer.set("rpm_set_FL", float(number), stamp=frozen)
            await peer.set("seq", number, stamp=frozen)
            await asyncio.sleep(0.02)
        assert any(key.startswith("frozen_stamp") for key in harness.status.faults)
        assert harness.status.one_way.count == 0
        assert harness.status.sequence_received >= 35


async def test_sequence_gaps_and_jumps(peer):
    harness = make_harness(peer_config(peer.port, mode="poll"))
    async with running(harness):
        await peer.set("seq", 10)
        await wait_until(lambda: harness.status.sequence_received >= 1)
        await peer.set("seq", 14)
        await wait_until(lambda: harness.status.sequence_missed == 3)
        await peer.set("seq", 5)
        await wait_until(lambda: harness.heard("jumped from 14 to 5"))
        assert harness.status.sequence_missed == 3


async def test_a_repeating_counter_is_named(peer):
    harness = make_harness(peer_config(peer.port, mode="poll"))
    async with running(harness, None):
        for number in range(60):
            await peer.set("rpm_set_FL", float(number))
            await asyncio.sleep(0.015)
            if harness.heard("repeats"):
                break
        assert harness.heard("repeats")


async def test_stale_by_sequence_although_the_server_answers(peer):
    harness = make_harness(peer_config(peer.port, on_stale="zero"))
    async with running(harness):
        await peer.cycle(rpm_set_FL=5.0)
        await wait_until(lambda: not harness.status.stale)
        await wait_until(lambda: harness.stale == ["peer:iot2050"])
        assert harness.status.connected
        await peer.cycle()
        await wait_until(lambda: harness.restored == ["iot2050"])
    # The constant set-point comes in again with the new number.
    assert harness.gate.groups[-1]["wheel.fl.setpoint_rpm"] == 5.0


async def test_without_a_counter_a_constant_setpoint_is_fresh(peer):
    harness = make_harness(peer_config(peer.port, sequence_node=None, mode="subscribe"))
    async with running(harness):
        await wait_until(lambda: not harness.status.stale)
        await asyncio.sleep(1.0)
        assert harness.stale == []


async def test_a_link_that_was_never_heard_is_stale_but_not_lost():
    harness = make_harness(peer_config(free_port()))
    async with running(harness):
        await wait_until(lambda: harness.status.failed_attempts >= 2)
        assert harness.status.stale
        assert harness.stale == []
        assert harness.status.last_error == "nothing is listening there"


async def test_outputs_are_written_back_with_stamp_and_status(peer):
    config = peer_config(
        peer.port,
        write={
            "wheel.fl.speed_rpm": f"nsu={URI};s=rpm_act_FL",
            "lights.state": f"nsu={URI};s=light",
        },
    )
    harness = make_harness(config)
    harness.outputs["wheel.fl.speed_rpm"] = (12.5, 0x40900000)
    harness.outputs["lights.state"] = (3.0, 0)
    async with running(harness):
        await wait_until(lambda: harness.status.writes > 3)
        value = await peer.read("rpm_act_FL")
        assert value.Value.Value == 12.5
        assert value.StatusCode.value == 0x40900000
        assert value.SourceTimestamp is not None
        light = await peer.read("light")
        assert (light.Value.Value, light.Value.VariantType) == (3, ua.VariantType.Byte)


async def test_outputs_are_written_as_good_where_the_peer_wants_it_so(peer):
    act = {w: f"nsu={URI};s=rpm_act_{w.upper()}" for w in ("fl", "fr")}
    write = {f"wheel.{w}.speed_rpm": node for w, node in act.items()}
    harness = make_harness(peer_config(peer.port, write=write, write_status="good"))
    harness.outputs["wheel.fl.speed_rpm"] = (
        12.5,
        ua.StatusCodes.UncertainLastUsableValue,
    )
    harness.outputs["wheel.fr.speed_rpm"] = (
        9.0,
        ua.StatusCodes.BadWaitingForInitialData,
    )
    async with running(harness, peer):
        await wait_until(lambda: harness.status.writes > 2)
        written = await peer.read("rpm_act_FL")
        assert (written.Value.Value, written.StatusCode.name) == (12.5, "Good")
        assert (await peer.read("rpm_act_FR")).Value.Value == 0.0


async def test_refused_and_impossible_writes_are_named(peer):
    config = peer_config(
        peer.port,
        write={
            "wheel.rr.speed_rpm": f"nsu={URI};s=read_only",
            "wheel.rl.speed_rpm": f"nsu={URI};s=label",
            "wheel.fr.speed_rpm": f"nsu={URI};s=absent",
            "wheel.fl.speed_rpm": f"nsu={URI};s=rpm_act_FL",
        },
    )
    harness = make_harness(config)
    harness.outputs["wheel.fl.speed_rpm"] = (7.0, 0)
    async with running(harness):
        await wait_until(lambda: harness.status.writes > 3)
        faults = " ".join(harness.status.faults.values())
        assert "refuses wheel.rr.speed_rpm" in faults
        assert "s=label is not numeric" in faults
        assert "s=absent does not exist" in faults
        assert (await peer.read("rpm_act_FL")).Value.Value == 7.0


@pytest.mark.parametrize("mode", ["subscribe", "poll"])
async def test_a_node_that_comes_later_is_found(mode):
    peer = await Peer(free_port(), leave_out=("rpm_set_RR",)).start()
    harness = make_harness(peer_config(peer.port, mode=mode))
    try:
        async with running(harness, peer):
            await wait_until(
                lambda: any("rpm_set_RR" in k for k in harness.status.faults)
            )
            await wait_until(lambda: harness.status.sequence_received > 20)
            assert harness.gate.groups == []
            assert not harness.heard("delivers fresh values")
            assert harness.stale == []
            await peer.add("rpm_set_RR", 4.0, ua.VariantType.Double)
            await wait_until(
                lambda: harness.gate.latest.get("wheel.rr.setpoint_rpm") == 4.0
            )
    finally:
        await peer.stop()


async def test_restarts_with_other_namespace_numbers_leave_nothing_behind():
    port = free_port()
    harness = make_harness(peer_config(port))
    tasks = None
    await harness.link.start()
    try:
        for number, before in enumerate((0, 3, 1), start=1):
            peer = await Peer(port, namespaces_before=before).start()
            for _ in range(
                number
            ):  # the number of a message that was read already says nothing
                await peer.cycle(rpm_set_FL=float(number))
            await wait_until(
                lambda: harness.gate.latest.get("wheel.fl.setpoint_rpm") == number  # noqa: B023
            )
            await wait_until(lambda: not harness.status.stale)
            await peer.stop()
            await wait_until(lambda: len(harness.stale) >= number)  # noqa: B023
            tasks = tasks or len(asyncio.all_tasks())
            await wait_until(lambda: len(asyncio.all_tasks()) <= tasks)  # noqa: B023
        assert harness.status.reconnects >= 2, (
            "a busy computer may lose a connection besides"
        )
        assert len(harness.restored) >= 2
    finally:
        await harness.link.stop()


async def test_a_link_that_breaks_while_it_is_stopped_ends_all_the_same(peer):
    line = PeerLine(peer_config(peer.port).name)
    harness = make_harness(peer_config(peer.port), line)
    await harness.link.start()
    await wait_until(lambda: harness.status.connected)
    line.inject(parse_fault({"fault": "disconnect", "peer": line.name}))
    async with asyncio.timeout(LIMIT_S):
        await harness.link.stop()
    assert harness.status.state == "stopped"


async def test_what_the_gate_refuses_is_named_and_not_repeated(peer):
    harness = make_harness(peer_config(peer.port, mode="poll"))
    harness.gate.refuse["wheel.rr.setpoint_rpm"] = Refusal.OUT_OF_RANGE
    async with running(harness, peer):
        await wait_until(lambda: harness.status.sequence_received > 20)
        assert harness.status.fault_counts["refused_value"] == 1
        assert harness.heard("wheel.rr.setpoint_rpm = 0.0 was refused: out_of_range")
