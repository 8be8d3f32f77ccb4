"""Subscribed clients for `bench opcua`: set up in Python, served by a small C program."""

import asyncio
import shutil
import socket
import struct
import subprocess
from collections.abc import Sequence
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any, NamedTuple

from asyncua import ua
from asyncua.ua.ua_binary import nodeid_to_binary

from benchmarks.wire import Wire
from hilserver.errors import FailedError

_PUBLISH_REQUESTS = 3
_FLAGS = ("-std=gnu11", "-O2")


class Delivered(NamedTuple):
    """Counts of what the clients have received."""

    values: int
    messages: int
    lost: int


def build(folder: Path) -> Path:
    """Compile the clients; FailedError if there is no compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        raise FailedError("the bench needs a C compiler (Debian: apt-get install gcc)")
    program = folder / "opcua_clients"
    with as_file(files("benchmarks") / "opcua_clients.c") as source:
        subprocess.run([compiler, *_FLAGS, "-o", program, source], check=True)  # noqa: S603
    return program


def build_open62541(folder: Path) -> Path | None:
    """Compile a server with open62541; None where its library is not installed."""
    asks, compiler = shutil.which("pkg-config"), shutil.which("cc")
    if asks is None or compiler is None:
        return None
    asked = subprocess.run(  # noqa: S603
        [asks, "--cflags", "--libs", "--static", "open62541"],
        capture_output=True,
        text=True,
        check=False,
    )
    if asked.returncode != 0:
        return None

    program = folder / "opcua_open62541"
    with as_file(files("benchmarks") / "opcua_open62541.c") as source:
        words = [*_FLAGS, "-o", str(program), str(source), *asked.stdout.split()]
        subprocess.run([compiler, *words], check=True)  # noqa: S603
    return program


class Clients:
    """Connected clients, each with one subscription to the same nodes."""

    def __init__(self, url: str) -> None:
        self._url = url
        self._wires: list[Wire] = []
        self._sockets: list[socket.socket] = []
        self._state = bytearray()
        self._token_bytes = 0

    async def subscribe(
        self,
        count: int,
        nodes: Sequence[ua.NodeId],
        interval_ms: float,
        queue_size: int,
    ) -> None:
        """Connect and subscribe `count` clients; what is costliest for the server comes last."""
        made = [await self._connect(interval_ms) for _ in range(count)]
        for wire, number in made:
            items = ua.CreateMonitoredItemsRequest()
            items.Parameters.SubscriptionId = number
            items.Parameters.TimestampsToReturn = ua.TimestampsToReturn.Both
            items.Parameters.ItemsToCreate = [
                _item(handle, node, queue_size) for handle, node in enumerate(nodes)
            ]
            answer = await wire.ask(items, ua.CreateMonitoredItemsResponse)
            for result in answer.Results:
                result.StatusCode.check()
        for wire, _ in made:
            for _ in range(_PUBLISH_REQUESTS):
                await wire.send(wire.message(ua.PublishRequest()))
            self._keep(wire)

    async def _connect(self, interval_ms: float) -> tuple[Wire, int]:
        wire = await Wire(self._url).__aenter__()
        await wire.log_in()
        create = ua.CreateSubscriptionRequest()
        create.Parameters.RequestedPublishingInterval = interval_ms
        create.Parameters.RequestedLifetimeCount = 10_000
        create.Parameters.RequestedMaxKeepAliveCount = 100
        create.Parameters.PublishingEnabled = True
        made = await wire.ask(create, ua.CreateSubscriptionResponse)
        return wire, int(made.Parameters.SubscriptionId)

    def _keep(self, wire: Wire) -> None:
        """Take the socket away from the event loop; data received so far is not counted."""
        transport: Any = wire._writer.transport
        transport.pause_reading()
        own = transport.get_extra_info("socket").dup()
        own.setblocking(True)
        self._wires.append(wire)
        self._sockets.append(own)
        token = bytes(nodeid_to_binary(wire.authentication))
        self._token_bytes = len(token)
        self._state += (
            struct.pack("<III", wire.channel, wire.token, wire._sequence + 1) + token
        )

    async def run(self, program: Path, duration_s: float) -> Delivered:
        """Count deliveries for `duration_s`; only once per set of clients."""
        numbers = [own.fileno() for own in self._sockets]
        process = await asyncio.create_subprocess_exec(
            program,
            str(duration_s),
            str(self._token_bytes),
            *map(str, numbers),
            stdin=asyncio.subprocess.PIPE,
            stdout=asyncio.subprocess.PIPE,
            pass_fds=numbers,
        )
        out, _ = await process.communicate(bytes(self._state))
        return Delivered(*map(int, out.split()))

    def close(self) -> None:
        """Disconnect without notice, so that the server serves the next ones alone."""
        for wire in self._wires:
            wire.abort()
        for own in self._sockets:
            own.close()


def _item(
    number: int, node: ua.NodeId, queue_size: int
) -> ua.MonitoredItemCreateRequest:
    item = ua.MonitoredItemCreateRequest(MonitoringMode=ua.MonitoringMode.Reporting)
    item.ItemToMonitor = ua.ReadValueId(NodeId=node, AttributeId=ua.AttributeIds.Value)
    item.RequestedParameters.ClientHandle = number
    item.RequestedParameters.SamplingInterval = 0.0
    item.RequestedParameters.QueueSize = queue_size
    item.RequestedParameters.DiscardOldest = True
    return item
