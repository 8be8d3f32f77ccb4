"""Our blocks as clients of two other makes see them, and as hostile ones try to."""

import asyncio
import json
import struct

import pytest
import snap7
from snap7.error import S7Error, S7ProtocolError

from hilserver.daemon.daemon import Daemon
from hilserver.errors import ConfigError, FailedError
from hilserver.io.s7 import server
from hilserver.io.s7.wire import Function, Item, asks, job
from hilserver.io.source import Source
from hilserver.signals import State
from tests.io.s7.rig import DRIVE, daemon_with, free_port
from tests.loopback.rig import wait_until

SCRIPT = "tests/s7_client/drive.cjs"
HELLO = bytes.fromhex("0300001611e00000000100c0010ac1020100c2020101")


async def test_a_panel_of_another_make_drives_and_reads(pytestconfig):
    async with daemon_with({1: DRIVE}) as (daemon, port):
        script = pytestconfig.rootpath / SCRIPT
        process = await asyncio.create_subprocess_exec(
            "node", script, str(port), stdout=asyncio.subprocess.PIPE
        )
        output, _ = await process.communicate()
        assert process.returncode == 0
        said = json.loads(output)
        assert said["values"]["DB1,REAL0"] == 30
        assert said["values"]["DB1,DINT8"] > 0
        assert said["values"]["DB1,X24.1"] is True
        assert said["denied"], "an output was written"
        assert daemon.gate.owner == "peer"
        status = daemon.part("s7").status
        assert status.writes > 0
        await wait_until(lambda: not status.connected)
        assert not status.faults


async def test_silence_is_judged_in_real_time_whatever_the_simulated_speed(monkeypatch):
    looks, judge = [], Source.watch

    def noting(source, now_ns):
        looks.append(source.name)
        return judge(source, now_ns)

    monkeypatch.setattr(Daemon, "_supervise", lambda *_: None)
    monkeypatch.setattr(Source, "watch", noting)
    async with daemon_with({1: DRIVE}):
        await wait_until(lambda: len(looks) > 5)
    assert len(set(looks)) == 1


def connected(port):
    client = snap7.client.Client()
    client.connect("127.0.0.1", 0, 1, port)
    return client


def refusal(call, *arguments):
    with pytest.raises(S7ProtocolError) as caught:
        call(*arguments)
    return str(caught.value)


def misuse(port):
    """What a client may not do; each is refused, and the connection goes on."""
    client = connected(port)
    said = {
        "an output": refusal(client.db_write, 1, 16, bytes(8)),
        "half a number": refusal(client.db_write, 1, 2, bytes(2)),
        "beyond the block": refusal(client.db_read, 1, 20, 8),
        "no such block": refusal(client.db_read, 7, 0, 4),
        "not a number": refusal(client.db_write, 1, 0, struct.pack(">f", float("nan"))),
        "too fast": refusal(client.db_write, 1, 0, struct.pack(">f", 1e9)),
    }
    assert len(client.db_read(1, 0, 25)) == 25
    assert client.get_cpu_info().ASName == b"hilserver"
    client.disconnect()
    return said


async def test_what_a_client_may_not_do_is_refused_by_code():
    async with daemon_with({1: DRIVE}) as (daemon, port):
        said = await asyncio.to_thread(misuse, port)
        codes = {what: sentence[-5:-1] for what, sentence in said.items()}
        assert codes == {
            "an output": "0x03",
            "half a number": "0x07",
            "beyond the block": "0x05",
            "no such block": "0x0a",
            "not a number": "0x03",
            "too fast": "0x03",
        }
        faults = daemon.part("s7").status.fault_counts
        assert +faults == {"refused_value": 2}
        slot = daemon.table.slot("wheel.fl.setpoint_rpm")
        assert daemon.image.frame_values[slot] == 0.0


async def test_who_has_no_control_is_denied_and_silence_ends_in_the_safe_state():
    async with daemon_with({1: DRIVE}, stale_after_ms=200) as (daemon, port):
        client = await asyncio.to_thread(connected, port)
        speed = struct.pack(">ff", 30.0, 30.0)
        await asyncio.to_thread(client.db_write, 1, 0, speed)
        await wait_until(lambda: daemon.control.state is State.SAFE)
        assert daemon.control.reason == "the S7 client is silent"
        daemon.gate.take("opcua")
        assert "0x03" in await asyncio.to_thread(refusal, client.db_write, 1, 0, speed)
        await asyncio.to_thread(client.disconnect)


@pytest.mark.parametrize(
    "sent",
    [
        b"GET / HTTP/1.1\r\n\r\n",
        b"\x03\x00\x00\x04",
        b"\x03\x00\xff\xff" + bytes(100),
        HELLO + b"\x03\0\0\x07\x02\xf0\x80",
        HELLO + b"\x03\0\0\x13\x02\xf0\x80\x32\x01\0\0\0\1\0\2\0\0\x04\xff",
    ],
)
async def test_what_is_no_s7_ends_its_connection_alone(sent):
    async with daemon_with({1: DRIVE}) as (daemon, port):
        client = await asyncio.to_thread(connected, port)
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(sent)
        await reader.read()
        writer.close()
        status = daemon.part("s7").status
        await wait_until(lambda: status.fault_counts["no_s7"] == 1)
        assert len(await asyncio.to_thread(client.db_read, 1, 0, 25)) == 25
        await asyncio.to_thread(client.disconnect)


@pytest.mark.parametrize(
    ("sent", "words"),
    [
        (b"", "it neither sends nor reads"),
        (HELLO[:9], "it neither sends nor reads"),
        (HELLO + b"\3", "ends in the middle of a message"),
        (HELLO + b"\3\0\0\x1f\x02", "ends in the middle of a message"),
        (HELLO + job(1, asks(Function.READ, [Item(1, 0, 400)])) * 100_000, "nor reads"),
    ],
    ids=["silent", "half a greeting", "a byte", "half a message", "reads nothing"],
)
async def test_half_open_connections_give_their_place_back(monkeypatch, sent, words):
    monkeypatch.setattr(server, "HANDSHAKE_S", 0.3)
    monkeypatch.setattr(server, "MESSAGE_S", 0.3)
    far = {"signal": "sim.tick", "at": 396, "type": "UDINT"}
    async with daemon_with({1: [*DRIVE, far]}, max_clients=1) as (daemon, port):
        _, writer = await asyncio.open_connection("127.0.0.1", port, limit=1)
        writer.write(sent)
        status = daemon.part("s7").status
        await wait_until(lambda: status.fault_counts["no_s7"] == 1)
        assert any(words in event.message for event in daemon.events.recent)
        await wait_until(lambda: not daemon.part("s7")._server.clients)
        client = await asyncio.to_thread(connected, port)
        assert len(await asyncio.to_thread(client.db_read, 1, 0, 25)) == 25
        await asyncio.to_thread(client.disconnect)
        writer.transport.abort()


async def test_there_is_a_place_for_so_many_clients_and_it_comes_back():
    async with daemon_with({1: DRIVE}, max_clients=2) as (daemon, port):
        clients = [await asyncio.to_thread(connected, port) for _ in range(2)]
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        assert await reader.read() == b""
        writer.close()
        sentence = "127.0.0.1 was turned away: s7.server.max_clients is 2"
        assert daemon.part("s7").status.fault_counts["no_room"] == 1
        assert any(sentence in event.message for event in daemon.events.recent)
        await asyncio.to_thread(clients[0].disconnect)
        await wait_until(lambda: len(daemon.part("s7")._server.clients) == 1)
        clients[0] = await asyncio.to_thread(connected, port)
        for client in clients:
            await asyncio.to_thread(client.disconnect)


async def test_who_only_opens_connections_keeps_no_controller_out():
    async with daemon_with({1: DRIVE}, max_clients=4) as (daemon, port):
        driver = await asyncio.to_thread(connected, port)
        halves = [await asyncio.open_connection("127.0.0.1", port) for _ in range(12)]
        for _, writer in halves[::2]:
            writer.write(HELLO)  # and no more
        for _ in range(3):
            controller = await asyncio.to_thread(connected, port)
            assert len(await asyncio.to_thread(controller.db_read, 1, 0, 25)) == 25
            await asyncio.to_thread(controller.disconnect)
        assert len(await asyncio.to_thread(driver.db_read, 1, 0, 25)) == 25
        assert not +daemon.part("s7").status.fault_counts
        await asyncio.to_thread(driver.disconnect)
        for _, writer in halves:
            writer.transport.abort()


async def test_a_newcomer_takes_the_place_of_who_has_been_idle_longest(monkeypatch):
    async with daemon_with({1: DRIVE}, max_clients=2) as (daemon, port):
        idle, busy = [await asyncio.to_thread(connected, port) for _ in range(2)]
        await asyncio.to_thread(busy.db_read, 1, 0, 25)
        monkeypatch.setattr("hilserver.io.places.YIELDS_AFTER_S", 0.0)
        newcomer = await asyncio.to_thread(connected, port)
        for client in (newcomer, busy):
            assert len(await asyncio.to_thread(client.db_read, 1, 0, 25)) == 25
        with pytest.raises((OSError, S7Error)):
            await asyncio.to_thread(idle.db_read, 1, 0, 25)
        assert len(daemon.part("s7")._server.clients) == 2
        assert not +daemon.part("s7").status.fault_counts
        for client in (idle, busy, newcomer):
            await asyncio.to_thread(client.disconnect)


async def test_a_port_that_is_taken_is_named():
    port = free_port()
    async with daemon_with({1: DRIVE}, port=port):
        with pytest.raises(
            FailedError, match=f"s7.server: cannot listen on 127.0.0.1 port {port}"
        ):
            async with daemon_with({1: DRIVE}, port=port):
                pass


@pytest.mark.parametrize(
    ("field", "words"),
    [
        ({"signal": "wheel.fl.speed", "at": 0}, "did you mean 'wheel.fl.speed_rpm'"),
        ({"signal": "drive.enable", "at": 0}, "'drive.enable' is BOOL, not REAL"),
        (
            {"signal": "sim.tick", "at": 0.0, "type": "BOOL"},
            "is a number, as REAL, not BOOL",
        ),
    ],
)
async def test_a_layout_that_fits_no_signal_is_named(field, words):
    with pytest.raises(ConfigError, match=f"s7.*block 3: .*{words}"):
        async with daemon_with({3: [field]}):
            pass
