"""A daemon that is stopped by a signal: what was sent meanwhile does not drive after it."""

import asyncio
import contextlib
import json
import os
import signal
import socket
import struct
import time
from pathlib import Path

import aiohttp
import pytest
from asyncua import ua

from hilserver.image import ImageReader
from hilserver.io.shield.protocol import ShieldCommand, request
from tests.helpers.daemons import free_port, running_daemon
from tests.io.opcua_server.rig import RobotClient
from tests.loopback.rig import wait_until

FL = "wheel.fl.setpoint_rpm"
DEADMAN_S, STOPPED_S = 0.5, 2.0
CONFIG = f"""
control: {{{{source: {{source}}}}}}
page: {{{{enabled: false, deadman_ms: {DEADMAN_S * 1e3:g}}}}}
foxglove: {{{{enabled: true, port: {{port}}}}}}
shield: {{{{enabled: true, link: shield, stale_after_ms: {DEADMAN_S * 1e3:g}}}}}
scheduler:
  communication_timeout_ms: 0
  limits: {{{{single_overrun_ms: null, consecutive_overruns: null}}}}
  realtime: {{{{priority: 0, lock_memory: false, hold_latency_target: false}}}}
"""


class AtOnce:
    """A transport that sends in the call, whatever the event loop does."""

    def __init__(self, transport):
        self._transport, self.sent = transport, 0

    def __getattr__(self, name):
        return getattr(self._transport, name)

    def write(self, data):
        connection = socket.socket(
            fileno=self._transport.get_extra_info("socket").fileno()
        )
        connection.send(data)
        connection.detach()
        self.sent += 1


class Teleop:
    """A client of OPC UA that named itself so; it has a dead-man."""

    source, stopped_s = "opcua", STOPPED_S

    def __init__(self, daemon, _port):
        self._client = RobotClient(daemon.url)
        self._client.description, self._said = "teleop", []

    async def connect(self):
        await self._client.connect()
        protocol = self._client.uaclient.protocol
        protocol.transport = self._transport = AtOnce(protocol.transport)

    async def say(self, rpm):
        await self._client.write((FL, rpm, ua.VariantType.Double))

    async def say_now(self, rpm):
        """Send it before this returns; nobody answers."""
        before = self._transport.sent
        self._said.append(asyncio.create_task(self.say(rpm)))
        while self._transport.sent == before:  # noqa: ASYNC110 - a step of the loop, not a time
            await asyncio.sleep(0)

    async def close(self):
        await asyncio.gather(*self._said)
        await self._client.disconnect()


class Viewer:
    """Foxglove, with a panel that publishes; what has waited may come for a second."""

    source, stopped_s = "page", STOPPED_S

    def __init__(self, _daemon, port):
        self._port = port

    async def connect(self):
        self._session = aiohttp.ClientSession()
        url = f"ws://127.0.0.1:{self._port}"
        self._socket = await self._session.ws_connect(
            url, protocols=["foxglove.sdk.v1"]
        )
        channel = {
            "id": 1,
            "topic": "/hilserver/set",
            "encoding": "json",
            "schemaName": "",
        }
        await self._socket.send_json({"op": "advertise", "channels": [channel]})

    async def say(self, rpm):
        await self._socket.send_bytes(
            struct.pack("<BI", 1, 1) + json.dumps({FL: rpm}).encode()
        )

    say_now = say  # a socket that is not full sends in the call

    async def close(self):
        await self._socket.close()
        await self._session.close()


class Host:
    """The robot's own driver on the serial line."""

    source, stopped_s = "shield", STOPPED_S

    def __init__(self, daemon, _port):
        self._link = daemon.folder / "shield"

    async def connect(self):
        self._file = os.open(self._link, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)

    async def say(self, rpm):
        speeds = struct.pack(
            "<4h", *(round(100 * sign * rpm) for sign in (-1, -1, 1, 1))
        )
        os.write(
            self._file,
            request(ShieldCommand.ENABLE) + request(ShieldCommand.SET_RPM, speeds),
        )
        with contextlib.suppress(BlockingIOError):
            os.read(self._file, 1 << 16)

    say_now = say

    async def close(self):
        os.close(self._file)


@pytest.mark.parametrize("kind", [Teleop, Viewer, Host])
async def test_what_was_sent_while_it_was_stopped_does_not_drive_after_it(
    tmp_path, kind
):
    port = free_port()
    with running_daemon(
        tmp_path, config=CONFIG.format(source=kind.source, port=port)
    ) as daemon:
        image = ImageReader.attach(daemon.image)
        slots = {row["name"]: row["slots"][0] for row in image.description["signals"]}
        client = kind(daemon, port)
        await client.connect()

        async def drives(rpm):
            await client.say(rpm)
            return image.latest().values[slots[FL]] == rpm

        await wait_until(lambda: drives(20.0))
        stopped(daemon.process)
        for _ in range(10):
            await client.say_now(50.0)
        time.sleep(kind.stopped_s)  # noqa: ASYNC251 - nothing of it is sent later
        head = image.head
        daemon.process.send_signal(signal.SIGCONT)
        frames = []

        def has_gone_on():  # read as they come: the ring does not keep them for ever
            frames.extend(image.frame(n) for n in range(head + len(frames), image.head))
            return len(frames) > 500

        await wait_until(has_gone_on)
        assert 50.0 not in {
            frame.values[slots[FL]] for frame in frames if frame is not None
        }
        await wait_until(lambda: drives(30.0))
        await client.close()


def stopped(process):
    """Stop a process and wait until all of its threads stand."""
    process.send_signal(signal.SIGSTOP)
    tasks = Path(f"/proc/{process.pid}/task")
    while any(_state(task) != "T" for task in tasks.iterdir()):
        time.sleep(0.01)


def _state(task):
    return (task / "stat").read_text().rpartition(")")[2].split()[0]
