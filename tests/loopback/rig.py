"""The real daemon in this process, seen through its sockets, and a peer it can be given."""

import asyncio
import time
import urllib.request
from collections.abc import Iterator
from contextlib import asynccontextmanager, suppress
from datetime import UTC, datetime

from asyncua import ua

from hilserver.config.root import Config
from hilserver.controller.nodes import SEQUENCE, SETPOINTS, node_id
from hilserver.controller.server import ControllerServer
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from tests.io.opcua_server.rig import RobotClient

RING_FRAMES = 8192
LIGHT = {"priority": 0, "lock_memory": False, "hold_latency_target": False}
"""What the shared computer of a test does not need to give."""


def configuration(*, scheduler=None, **sections):
    """Any free ports, an ordinary thread, no limits that a busy computer would exceed."""
    limits = {"single_overrun_ms": None, "consecutive_overruns": None}
    ours = {
        "image": {"name": "auto", "ring_frames": RING_FRAMES},
        "opcua": {
            "endpoint": "opc.tcp://127.0.0.1:0/hilserver",
            "max_events_per_s": 1000,
        },
        "metrics": {"port": 0},
        "scheduler": {
            "realtime": LIGHT,
            "limits": limits,
            "communication_timeout_ms": 0,
        }
        | (scheduler or {}),
    }
    return Config.model_validate(ours | sections)


@asynccontextmanager
async def serving(assembly):
    """A daemon that runs, and a client of its OPC UA server."""
    async with Daemon(assembly) as daemon:
        client = RobotClient(daemon.part("opcua").url)
        await client.connect()
        try:
            yield daemon, client
        finally:
            await client.disconnect()


def running(config, folder=None):
    """Like `serving`, from a configuration."""
    return serving(assemble_config(config, folder))


async def wait_until(condition, timeout_s=120.0):
    """Wait until `condition()`, plain or awaitable, is true."""
    async with asyncio.timeout(timeout_s):
        while True:
            met = condition()
            if asyncio.iscoroutine(met):
                met = await met
            if met:
                return
            await asyncio.sleep(0.005)


async def scrape(daemon, path="/metrics"):
    """GET of the daemon's HTTP server, as text."""

    base = daemon.part("metrics").url.rsplit("/", 1)[0]

    def get():
        with urllib.request.urlopen(f"{base}{path}", timeout=120) as r:
            return r.read().decode()

    return await asyncio.to_thread(get)


def frames(daemon, since=0) -> Iterator:
    """Every frame from number `since` on that is still in the ring."""
    for number in range(
        max(since, daemon.image.head - RING_FRAMES + 256), daemon.image.head
    ):
        frame = daemon.image.frame(number)
        assert frame is not None, f"frame {number} was overwritten while it was read"
        yield frame


def column(daemon, name, since=0):
    """Value of one signal in every frame from number `since` on."""
    slot = daemon.table.slot(name)
    return [float(frame.values[slot]) for frame in frames(daemon, since)]


def newest(daemon, name):
    """Value of one signal in the newest frame; the plant may publish more of them meanwhile."""
    return column(daemon, name, daemon.image.head - 1)[-1]


async def run_ticks(daemon, n):
    """Wait until `n` more frames are published; return the number of the first of them."""
    head = daemon.image.head
    await wait_until(lambda: daemon.image.head >= head + n)
    return head


async def call(client, name, *arguments):
    """Call a method; return the name of its status code."""
    return (await client.call(name, *arguments)).StatusCode.name


async def take(client, source):
    """Write control.source; return the name of the status code."""
    return (await client.write(("control.source", source, ua.VariantType.String)))[0]


def double(value):
    return ua.Variant(float(value), ua.VariantType.Double)


def text(value):
    return ua.Variant(value, ua.VariantType.String)


def uint32(value):
    return ua.Variant(value, ua.VariantType.UInt32)


class Inbox:
    """Events that an OPC UA client receives from the robot."""

    def __init__(self):
        self.events = []

    def event_notification(self, event):
        self.events.append(event)

    def has(self, kind, words=""):
        return any(e.Kind == kind and words in e.Message.Text for e in self.events)


@asynccontextmanager
async def inbox(client):
    box = Inbox()
    subscription = await client.create_subscription(20, box)
    base = client.path("types.RobotEventType")
    await subscription.subscribe_events(client.path("robot"), base, queuesize=1000)
    try:
        yield box
    finally:
        await subscription.delete()


class Peer(ControllerServer):
    """A controller that offers what the test says, every 20 ms while it is not silent."""

    def __init__(self, nodes=tuple(SETPOINTS)):
        super().__init__("opc.tcp://127.0.0.1:0/UA/NodeRedAgv")
        self.values = {node: (True if node == "enable" else 0.0) for node in nodes}
        self.is_silent = False
        self.sequence = 0
        self.offered_ns = 0
        self._task = None

    async def __aenter__(self):
        await super().__aenter__()
        self._task = asyncio.create_task(self._run())
        return self

    async def __aexit__(self, *error):
        self._task.cancel()
        with suppress(asyncio.CancelledError):
            await self._task
        await super().__aexit__(*error)

    async def _run(self):
        while True:
            if not self.is_silent:
                self.sequence += 1
                self.offered_ns = time.monotonic_ns()
                await self.offer(
                    self.values | {SEQUENCE: self.sequence}, datetime.now(UTC)
                )
            await asyncio.sleep(0.02)

    def set(self, fl, rl, fr, rr):
        """Offer these wheel speeds [rpm] from now on."""
        for node, rpm in zip(("FL", "RL", "FR", "RR"), (fl, rl, fr, rr), strict=True):
            self.values[f"rpm_set_{node}"] = rpm

    def config(self, name="plc", **changes):
        """Section of `peers:` for this server."""
        ours = {
            "name": name,
            "endpoint": self.endpoint,
            "mode": "poll",
            "poll_ms": 10,
            "stale_after_ms": 200,
            "sequence_node": node_id(SEQUENCE),
            "read": {node_id(node): SETPOINTS[node] for node in self.values},
        }
        return ours | changes
