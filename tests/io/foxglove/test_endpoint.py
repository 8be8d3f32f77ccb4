"""The endpoint as viewers see it: a raw WebSocket client of its protocol."""

import asyncio
import contextlib
import json
import socket
import struct
import time
from contextlib import asynccontextmanager

import aiohttp
import pytest
from mcap_ros2._dynamic import generate_dynamic
from structlog.testing import capture_logs

from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from hilserver.errors import FailedError
from hilserver.io.arrival import WATCH_NS
from hilserver.io.foxglove.door import LARGEST_MESSAGE, ViewerDoor
from hilserver.io.foxglove.endpoint import HANDED_OVER_NS
from hilserver.ros.types import known_types
from tests.io.ros2.rig import value
from tests.loopback.rig import configuration, wait_until
from tests.node_red.resources import Holdings

PATIENCE_S = 60.0
SPEAKS = "Sec-WebSocket-Protocol: foxglove.sdk.v1\r\n"
NOT_A_NUMBER = b'{"wheel.fl.setpoint_rpm": NaN}'
MESSAGE_DATA, CLIENT_MESSAGE = 1, 1


@asynccontextmanager
async def robot(port=0, **opcua):
    ours = {"enabled": True, "port": port}
    config = configuration(foxglove=ours, opcua={"enabled": False, **opcua})
    async with Daemon(assemble_config(config)) as daemon:
        yield daemon


class Viewer:
    """Speaks ``foxglove.sdk.v1``: JSON for control, binary frames for data."""

    def __init__(self, url, protocols=("foxglove.sdk.v1",)):
        self._url, self._protocols = url, protocols
        self.channels, self.received, self.info = {}, {}, None

    async def __aenter__(self):
        self._session = aiohttp.ClientSession()
        self._socket = await self._session.ws_connect(
            self._url, protocols=self._protocols
        )
        self._reading = asyncio.create_task(self._read())
        await wait_until(lambda: len(self.channels) >= 3 and self.info, PATIENCE_S)
        return self

    async def __aexit__(self, *_):
        self._reading.cancel()
        await asyncio.gather(self._reading, return_exceptions=True)
        await self._socket.close()
        await self._session.close()

    async def _read(self):
        async for message in self._socket:
            if message.type is aiohttp.WSMsgType.TEXT:
                data = json.loads(message.data)
                if data["op"] == "advertise":
                    self.channels |= {
                        channel["topic"]: channel for channel in data["channels"]
                    }
                elif data["op"] == "serverInfo":
                    self.info = data
            elif message.data[0] == MESSAGE_DATA:
                (number,) = struct.unpack_from("<I", message.data, 1)
                self.received.setdefault(number, []).append(message.data[13:])

    async def subscribe(self, topic, number):
        wanted = {"id": number, "channelId": self.channels[topic]["id"]}
        await self._socket.send_json({"op": "subscribe", "subscriptions": [wanted]})
        await wait_until(lambda: self.received.get(number), PATIENCE_S)
        return self.received[number]

    async def advertise(self, number, topic, encoding, schema=""):
        channel = {
            "id": number,
            "topic": topic,
            "encoding": encoding,
            "schemaName": schema,
        }
        await self._socket.send_json({"op": "advertise", "channels": [channel]})

    @property
    def protocol(self):
        return self._socket.protocol

    @property
    def is_closed(self):
        return self._reading.done()

    async def publish(self, number, data):
        await self._socket.send_bytes(struct.pack("<BI", CLIENT_MESSAGE, number) + data)


async def test_signals_transforms_and_hall():
    async with robot() as daemon, Viewer(daemon.part("foxglove").url) as viewer:
        assert set(viewer.channels) == {"/hilserver/frame", "/transforms", "/scene"}
        channel = viewer.channels["/hilserver/frame"]
        assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
        name = channel["schemaName"]
        decode = generate_dynamic(name, channel["schema"])[name]
        frames = await viewer.subscribe("/hilserver/frame", 1)
        assert decode(frames[-1]).battery.voltage_v > 10
        await wait_until(lambda: len(frames) > 3, PATIENCE_S)
        assert decode(frames[-1]).sim.tick > decode(frames[0]).sim.tick
        assert viewer.channels["/transforms"]["schemaName"] == "foxglove.FrameTransform"
        assert b"base_link" in (await viewer.subscribe("/transforms", 2))[0]
        assert b"hall" in (await viewer.subscribe("/scene", 3))[0]


@pytest.mark.parametrize(
    ("asked", "spoken"),
    [
        (["foxglove.websocket.v1"], "foxglove.websocket.v1"),
        (["foxglove.websocket.v1", "foxglove.sdk.v1"], "foxglove.sdk.v1"),
        (["other", "foxglove.sdk.v1"], "foxglove.sdk.v1"),
    ],
)
async def test_viewers_of_both_versions_are_served(asked, spoken):
    """Before, an older viewer was refused for a missing header, although it had sent one."""
    async with robot() as daemon, Viewer(daemon.part("foxglove").url, asked) as viewer:
        assert viewer.protocol == spoken
        assert await viewer.subscribe("/transforms", 1)


async def test_a_viewer_of_an_unknown_version_is_refused_in_a_sentence():
    async with robot() as daemon, aiohttp.ClientSession() as session:
        url = daemon.part("foxglove").url
        with capture_logs() as logs:
            for protocols in (["foxglove.sdk.v9"], []):
                with pytest.raises(aiohttp.WSServerHandshakeError, match="400"):
                    await session.ws_connect(url, protocols=protocols)
        refused = [line for line in logs if "viewer refused" in line["event"]]
        assert [line["asks_for"] for line in refused] == ["foxglove.sdk.v9", "none"]
        assert refused[0]["known"] == "foxglove.sdk.v1, foxglove.websocket.v1"


async def test_what_the_sdk_hands_over_late_after_a_standstill_is_as_old_as_that():
    async with robot() as daemon:
        arrivals = daemon.part("foxglove")._arrivals
        stood = time.monotonic_ns()
        back = stood + 2_000_000_000
        until = back + HANDED_OVER_NS
        arrivals.look(stood)
        for at in range(back, until, WATCH_NS):
            assert arrivals.came_ns(at) == stood
            arrivals.look(at)
        assert arrivals.came_ns(until) == until


async def test_what_is_published_obeys_control_and_the_dead_man(caplog):
    async with robot() as daemon, Viewer(daemon.part("foxglove").url) as viewer:
        await viewer.advertise(1, "/cmd_vel", "json", "geometry_msgs/Twist")
        await viewer.advertise(2, "/hilserver/set", "json")
        await viewer.advertise(3, "/cmd_vel", "cdr", "geometry_msgs/msg/Twist")
        twist = json.dumps({"linear": {"x": 0.2}, "angular": {"z": 0.1}}).encode()
        await viewer.publish(1, twist)
        rejected = daemon.gate.rejected
        await wait_until(lambda: rejected["page", "not_in_control"] > 0, PATIENCE_S)
        assert value(daemon, "twist.linear_m_s") == 0.0

        daemon.gate.take("page")

        async def renew():
            while True:
                await viewer.publish(1, twist)
                await asyncio.sleep(0.05)

        held = asyncio.create_task(renew())
        await wait_until(lambda: value(daemon, "twist.linear_m_s") == 0.2, PATIENCE_S)
        held.cancel()
        await wait_until(lambda: value(daemon, "twist.linear_m_s") == 0.0, PATIENCE_S)

        await viewer.publish(
            2, json.dumps({"lights.command": 4, "control.mode": 0}).encode()
        )
        await wait_until(lambda: value(daemon, "lights.command") == 4.0, PATIENCE_S)
        assert value(daemon, "control.mode") == 0.0
        make, vector = known_types().make, "geometry_msgs/msg/Vector3"
        still = make(vector, x=0.0, y=0.0, z=0.0)
        message = make("geometry_msgs/msg/Twist", linear=still, angular=still)
        await viewer.publish(3, known_types().encode(message))
        await wait_until(lambda: value(daemon, "control.mode") == 1.0, PATIENCE_S)
        digits = b'{"wheel.fl.setpoint_rpm": 1%s}' % (b"0" * 400)
        nested = b"[" * 50_000, b'{"linear": ' * 5_000
        for wrong in (
            b"",
            b"[]",
            b'{"linear": []}',
            b"{",
            b"\xff",
            digits,
            *nested,
            NOT_A_NUMBER,
        ):
            await viewer.publish(2, wrong)
            await viewer.publish(1, wrong)
        # Of two that arrive at once, the newest counts.
        await wait_until(lambda: rejected["page", "not_finite"] >= 1, PATIENCE_S)
        assert not [record for record in caplog.records if record.levelname == "ERROR"]
        await viewer.publish(2, json.dumps({"lights.command": 2}).encode())
        await wait_until(lambda: value(daemon, "lights.command") == 2.0, PATIENCE_S)


async def test_a_port_in_use_is_a_sentence():
    async with robot() as first:
        port = int(first.part("foxglove").url.rsplit(":", 1)[1])
        with pytest.raises(FailedError, match="foxglove: cannot listen on"):
            async with robot(port):
                pass


def many(count=1900):
    """A message of names that nobody knows, as long as one may be."""
    return json.dumps({f"no.such.signal.{i}.x": i for i in range(count)}).encode()


async def test_a_flood_of_unknown_names_holds_nobody_up():
    """Its sender waits for its share; who drives beside it is served within a moment."""
    loop, flood, longest_s = asyncio.get_running_loop(), many(), 0.0
    assert len(flood) < LARGEST_MESSAGE

    async def pace():
        nonlocal longest_s
        while True:
            before_s = loop.time()
            await asyncio.sleep(0.005)
            longest_s = max(longest_s, loop.time() - before_s - 0.005)

    async def send(viewer):
        while True:
            await viewer.publish(1, flood)

    async with (
        robot() as daemon,
        Viewer(daemon.part("foxglove").url) as hostile,
        Viewer(daemon.part("foxglove").url) as honest,
    ):
        await hostile.advertise(1, "/hilserver/set", "json")
        await honest.advertise(1, "/hilserver/set", "json")
        daemon.gate.take("page")
        before_kb = Holdings.of().memory_kib
        tasks = [asyncio.create_task(work) for work in (pace(), send(hostile))]
        begun_s, served_s = loop.time(), []
        while loop.time() - begun_s < 1.5:
            wanted, asked_s = float(1 + len(served_s) % 4), loop.time()
            await honest.publish(1, json.dumps({"lights.command": wanted}).encode())
            await wait_until(
                lambda wanted=wanted: value(daemon, "lights.command") == wanted, 5.0
            )
            served_s.append(loop.time() - asked_s)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        assert longest_s < 0.25
        assert max(served_s) < 1.0
        assert Holdings.of().memory_kib - before_kb < 50 * 1024
        assert len(daemon.events.recent) < 500
        assert daemon.control.state.name == "RUNNING"


async def test_a_message_that_is_too_long_ends_its_connection_and_nothing_else():
    async with robot() as daemon, Viewer(daemon.part("foxglove").url) as viewer:
        await viewer.advertise(1, "/hilserver/set", "json")
        long = json.dumps({"x": "y" * LARGEST_MESSAGE}).encode()
        await viewer.publish(1, long)
        await wait_until(lambda: viewer.is_closed, PATIENCE_S)
        async with Viewer(daemon.part("foxglove").url) as another:
            assert another.info


@pytest.mark.parametrize(
    ("origin", "enters"),
    [
        (None, True),
        ("https://app.foxglove.dev", True),
        ("file://", True),
        ("https://own.example", True),
        ("https://evil.example", False),
        ("https://app.foxglove.dev.evil.example", False),
        ("http://127.0.0.1:8080", False),
        ("null", False),
    ],
)
async def test_only_named_web_pages_enter(origin, enters):
    named = ["https://app.foxglove.dev", "file://", "https://own.example/"]
    door, asked = ViewerDoor(named), []

    async def behind(reader, writer):
        asked.append(await reader.readuntil(b"\r\n\r\n"))
        writer.write(b"HTTP/1.1 101 Switching Protocols\r\n\r\n")
        writer.close()

    server = await asyncio.start_server(behind, "127.0.0.1", 0)
    await door.open("127.0.0.1", 0, server.sockets[0].getsockname())
    reader, writer = await asyncio.open_connection("127.0.0.1", door.port)
    line = "" if origin is None else f"Origin: {origin}\r\n"
    writer.write(f"GET / HTTP/1.1\r\nHost: x\r\n{SPEAKS}{line}\r\n".encode())
    status = (await reader.readline()).split()[1]
    assert status == (b"101" if enters else b"403")
    assert bool(asked) == enters
    writer.close()
    await door.close()
    server.close()


async def test_viewers_that_ask_for_nothing_keep_nobody_out(monkeypatch):
    monkeypatch.setattr("hilserver.io.foxglove.door.CONNECTIONS", 3)
    door, hello = ViewerDoor([]), f"GET / HTTP/1.1\r\n{SPEAKS}\r\n".encode()

    async def behind(reader, writer):
        await reader.readuntil(b"\r\n\r\n")
        writer.write(b"HTTP/1.1 101 Switching Protocols\r\n\r\n")
        with contextlib.suppress(OSError):
            await reader.read()
        writer.close()

    async def viewer(asks=b""):
        reader, writer = await asyncio.open_connection("127.0.0.1", door.port)
        writer.write(hello)
        await reader.readuntil(b"\r\n\r\n")
        writer.write(asks)
        return reader, writer

    server = await asyncio.start_server(behind, "127.0.0.1", 0)
    await door.open("127.0.0.1", 0, server.sockets[0].getsockname())
    asking = await viewer(b"\x82\x81\0\0\0\0\1")
    await wait_until(lambda: any(place.use for place in door._places._held))
    idle = [await viewer() for _ in range(6)]
    async with asyncio.timeout(PATIENCE_S):
        with contextlib.suppress(ConnectionError):
            assert await idle[0][0].read() == b""
    assert not asking[0].at_eof()
    for _, writer in [asking, *idle]:
        writer.transport.abort()
    await door.close()
    server.close()


async def test_a_viewer_that_takes_nothing_gives_its_place_back(monkeypatch):
    """Its address is named, though it has none for uvloop once it has left."""
    monkeypatch.setattr("hilserver.io.foxglove.door.UNREAD_S", 0.2)
    door, has_ended = ViewerDoor([]), asyncio.Event()

    async def behind(reader, writer):
        await reader.readuntil(b"\r\n\r\n")
        monkeypatch.setattr(asyncio.StreamWriter, "get_extra_info", lambda *_: None)
        writer.write(b"HTTP/1.1 101 Switching Protocols\r\n\r\n")
        with contextlib.suppress(OSError):
            while True:
                writer.write(bytes(65_536))
                await writer.drain()
        has_ended.set()

    server = await asyncio.start_server(behind, "127.0.0.1", 0)
    await door.open("127.0.0.1", 0, server.sockets[0].getsockname())
    with (
        capture_logs() as lines,
        socket.create_connection(("127.0.0.1", door.port)) as viewer,
    ):
        viewer.sendall(f"GET / HTTP/1.1\r\n{SPEAKS}\r\n".encode())
        async with asyncio.timeout(PATIENCE_S):
            await has_ended.wait()
    (line,) = lines
    assert "does not take" in line["event"]
    assert line["address"] == "127.0.0.1"
    await door.close()
    server.close()


async def test_once_strangers_only_watch_a_viewer_writes_nothing():
    async with (
        robot(anonymous="observer") as daemon,
        Viewer(daemon.part("foxglove").url) as viewer,
    ):
        daemon.gate.take("page")
        await viewer.advertise(1, "/hilserver/set", "json")
        name = "measured.wheel.fl.speed_rpm"
        await viewer.publish(
            1, json.dumps({name: 12.5, "wheel.fl.setpoint_rpm": 30.0}).encode()
        )
        await wait_until(
            lambda: daemon.gate.rejected["page", "not_granted"] == 2, PATIENCE_S
        )
        assert value(daemon, "wheel.fl.setpoint_rpm") == 0.0
        assert value(daemon, name) != 12.5


async def test_the_door_is_before_the_server():
    async with robot() as daemon, aiohttp.ClientSession() as session:
        url, protocols = daemon.part("foxglove").url, ["foxglove.sdk.v1"]
        with pytest.raises(aiohttp.WSServerHandshakeError) as refused:
            await session.ws_connect(
                url, origin="https://evil.example", protocols=protocols
            )
        assert refused.value.status == 403
        origin = "https://app.foxglove.dev"
        await (
            await session.ws_connect(url, origin=origin, protocols=protocols)
        ).close()
