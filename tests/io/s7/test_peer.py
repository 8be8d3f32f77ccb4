"""Our peer against a controller of another make: the server of python-snap7."""

import struct

import pytest
from snap7.type import SrvArea

from hilserver.config.s7 import Endpoint
from hilserver.io.link_status import LinkState
from hilserver.io.s7.connection import AnswerError, S7Connection, S7Write
from hilserver.io.s7.peer import SOONER, ReadPace
from hilserver.io.s7.wire import Item
from tests.io.s7.rig import Link, controller, free_port
from tests.loopback.rig import wait_until

TORN = 999.0


def newest(link):
    return link.gate.groups[-1] if link.gate.groups else {}


async def test_set_points_come_in_and_outputs_go_back_in_whatever_order_the_sides_start():
    port = free_port()
    async with Link(port) as link:
        await wait_until(lambda: link.status.failed_attempts > 1)
        assert link.status.last_error == "nothing is listening there"
        for number, speed in ((7, 20.0), (8, -7.5)):
            await come_and_go(link, port, number, speed)
        assert link.status.reconnects >= 1


async def come_and_go(link, port, number, speed):
    link.outputs["wheel.fl.speed_rpm"] = speed
    with controller(port) as plc:
        plc.offer(number, number, speed, -speed)
        await wait_until(lambda: newest(link).get("wheel.fr.setpoint_rpm") == -speed)
        assert newest(link)["wheel.fl.setpoint_rpm"] == speed
        assert newest(link)["input.sequence"] == number
        await wait_until(lambda: struct.unpack_from(">f", plc.going, 4) == (speed,))
        assert link.status.state is LinkState.CONNECTED
        await wait_until(lambda: not link.status.stale)
    await wait_until(lambda: link.gate.stale and not link.status.connected)
    link.gate.stale.clear()


async def test_a_block_that_is_half_written_is_dropped_and_counted():
    port = free_port()
    with controller(port) as plc:
        async with Link(port) as link:
            plc.offer(1, 1, 10.0, 10.0)
            await wait_until(lambda: newest(link).get("input.sequence") == 1)
            plc.offer(2, 1, TORN, 10.0)
            await wait_until(lambda: link.status.fault_counts["torn_read"] > 3)
            plc.offer(3, 3, 30.0, 30.0)
            await wait_until(lambda: newest(link).get("input.sequence") == 3)
        values = {group["wheel.fl.setpoint_rpm"] for group in link.gate.groups}
        assert values == {10.0, 30.0}
        assert link.status.faults.keys() == {"torn_read:DB1"}


async def test_a_counter_that_stands_still_is_silence_though_the_server_answers():
    port = free_port()
    with controller(port) as plc:
        async with Link(port) as link:
            plc.offer(1, 1, 10.0, 10.0)
            await wait_until(lambda: not link.status.stale)
            await wait_until(lambda: link.status.stale and link.gate.stale)
            assert link.status.connected


@pytest.mark.parametrize("cycle_s", [0.0099, 0.01, 0.0101])
@pytest.mark.parametrize("phase", [0.0, 0.3, 0.999])
def test_reads_follow_the_writes_of_a_controller_of_the_same_cycle(cycle_s, phase):
    period_s, now_s = 0.01, phase * cycle_s
    pace, lags_s, reads, seen = ReadPace(period_s), [], 0, -1
    while now_s < 10.0:
        number = int(now_s / cycle_s)
        if number != seen:
            lags_s.append(now_s - number * cycle_s)
        seen, reads = number, reads + 1
        now_s += pace.after(number)
    step_s = period_s / SOONER
    assert max(lags_s[SOONER:]) < step_s + 1e-9
    assert len(lags_s) >= 10.0 / cycle_s - SOONER  # none is missed
    assert reads < 2.3 * 10.0 / period_s


def test_a_counter_that_stands_and_one_that_is_torn_are_read_once_a_period_in_the_end():
    pace = ReadPace(0.01)
    waits = [pace.after(number) for number in (1, *(None, 1) * SOONER)]
    assert waits[: SOONER + 1] == [
        0.01 * (SOONER - 1) / SOONER,
        *(0.01 / SOONER,) * SOONER,
    ]
    assert set(waits[SOONER + 1 :]) == {0.01}


async def test_a_counter_of_two_bytes_begins_anew_without_a_jump():
    port = free_port()
    ends = ["DB1,UINT0", "DB1,UINT14"]
    heartbeat = {"read": ends}
    with controller(port) as plc:
        async with Link(port, heartbeat=heartbeat) as link:
            for number in (65534, 65535, 0, 1):
                struct.pack_into(">H", plc.coming, 14, number)
                struct.pack_into(">H", plc.coming, 0, number)
                await wait_until(lambda: newest(link).get("input.sequence") == number)  # noqa: B023
            assert link.status.fault_counts["sequence_jump"] == 0


async def test_a_block_that_is_not_there_is_named_and_found_once_it_is():
    port = free_port()
    with controller(port) as plc:
        read = {"DB3,REAL4": "wheel.fl.setpoint_rpm"}
        async with Link(port, read=read, heartbeat={}, write={}) as link:
            await wait_until(lambda: "missing_node:DB3" in link.status.faults)
            assert "DB3" in link.status.faults["missing_node:DB3"]
            block = bytearray(struct.pack(">ff", 0.0, 5.0))
            plc.server.register_area(SrvArea.DB, 3, block)
            await wait_until(lambda: newest(link).get("wheel.fl.setpoint_rpm") == 5.0)


async def test_blocks_of_any_length_travel_in_parts():
    port = free_port()
    with controller(port, size=1000) as plc:
        plc.coming[:] = bytes(i * 7 % 251 for i in range(1000))
        async with S7Connection(Endpoint("127.0.0.1", port, 0, 1)) as connection:
            for size in (1, 221, 222, 223, 461, 462, 463, 464, 900, 925):
                assert await connection.read(1, 3, size) == plc.coming[3 : 3 + size]
                sent = bytes(i * 5 % 241 for i in range(size))
                await connection.write([S7Write(Item(2, 8 * 4, size), sent)])
                assert plc.going[4 : 4 + size] == sent
            with pytest.raises(AnswerError, match="DB9: "):
                await connection.read(9, 0, 4)
            assert await connection.read(1, 0, 4) == plc.coming[:4]
