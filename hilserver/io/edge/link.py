"""Connects the databus with the robot: groups at their rates, writes through the gate.

While the broker is away nothing piles up: only the newest frame of each group waits.
"""

import asyncio
import random
import ssl
import time
from collections.abc import Callable
from enum import StrEnum
from typing import Any, Final

import aiomqtt
import structlog

from hilserver.config.edge import EdgeConfig
from hilserver.image import Frame
from hilserver.io.arrival import WATCH_S
from hilserver.io.edge import payload
from hilserver.io.edge.credentials import credentials
from hilserver.io.edge.payload import Collection
from hilserver.io.link_status import LinkState, PeerStatus
from hilserver.io.source import Source
from hilserver.io.world import Part, World
from hilserver.tasks import SupervisedTask, together
from hilserver.time_limit import time_limit

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 10.0
ANSWER_S: Final = 5.0
LEAVE_S, DISCONNECT_S = 0.3, 0.1
KEEPALIVE_S: Final = 10
EARLY_NS: Final = 2_000_000  # a frame this early counts as the one that is due
PROTOCOLS: Final = {
    "3.1.1": aiomqtt.ProtocolVersion.V311,
    "5": aiomqtt.ProtocolVersion.V5,
}

_log = structlog.get_logger(__name__)


class EdgeFault(StrEnum):
    """What can be wrong with the databus."""

    NO_BROKER = "no_broker"
    BAD_WRITE = "bad_write"


class EdgeLink(Part):
    """One client of the broker for as long as the daemon runs."""

    section, label = "edge", "databus"
    status: PeerStatus  # always up to date; `writes` counts messages with values sent

    def __init__(self, config: EdgeConfig, world: World) -> None:
        self._config = config
        self._world = world
        self.status = PeerStatus(
            "edge", f"mqtt://{config.host}:{config.port}", mode="mqtt"
        )
        self.status.stale = config.drives  # without writers nothing is waited for
        self._source = Source(
            config.driver,
            "databus",
            self.status,
            world.gate,
            world.events.publish,
            fresh=lambda: "databus: values are coming in",
            kinds=EdgeFault,
        )
        with world.at("edge"):
            self._collections = payload.collections_of(config, world.table)
        self._by_topic = {c.write_topic: c for c in self._collections if c.write_topic}
        self._due_ns = dict.fromkeys(range(len(self._collections)), 0)
        self._waiting: dict[int, Frame] = {}
        self._news = asyncio.Event()
        self._numbers = [0] * len(self._collections)
        self._status_number = 0
        self._job: SupervisedTask | None = None
        self._watching: SupervisedTask | None = None
        self._client: aiomqtt.Client | None = None

    @property
    def address(self) -> str:
        """The broker."""
        return self.status.endpoint

    async def start(self) -> None:
        """Connect, and again after every loss; ConfigError if a file cannot be used."""
        password, context = credentials(self._config, self._world.folder)
        self.status.state = LinkState.CONNECTING
        tasks = self._world.tasks
        self._job = tasks.keep("edge", lambda: self._stay_connected(password, context))
        if self._config.drives:
            self._watching = tasks.every("edge: watch", WATCH_S, self._look)

    async def stop(self) -> None:
        """Announce the end and disconnect; if that takes too long, the last will announces it."""
        if self._watching is not None:
            self._watching.cancel()
        try:
            for _ in range(2):  # a library may swallow the first cancellation
                if self._job is not None:
                    self._job.cancel()
                    await asyncio.wait({self._job.task}, timeout=LEAVE_S + DISCONNECT_S)
        finally:
            self._drop()
        self.status.connected = False
        self.status.state = LinkState.STOPPED

    def publish(self, frame: Frame) -> None:
        """Send the groups that are due; a newer frame replaces one that waits."""
        for index, collection in enumerate(self._collections):
            if frame.planned_ns < self._due_ns[index] - EARLY_NS:
                continue
            period_ns = round(1e9 / collection.group.rate_hz)
            on_time = self._due_ns[index] + period_ns
            self._due_ns[index] = max(on_time, frame.planned_ns + period_ns // 2)
            self._waiting[index] = frame
            self._news.set()

    def _look(self) -> None:
        """Check for silence of the writers."""
        self._source.watch(time.monotonic_ns())

    # --- the connection ---------------------------------------------------------------------------

    async def _stay_connected(
        self, password: str | None, context: ssl.SSLContext | None
    ) -> None:
        pause_s = FIRST_PAUSE_S
        while True:
            begun_s = time.monotonic()
            try:
                config = self._config
                will = payload.status(config, 0, time.time_ns(), available=False)
                last_will = aiomqtt.Will(
                    payload.status_topic(config), will, qos=config.qos, retain=True
                )
                self._client = aiomqtt.Client(
                    config.host,
                    config.port,
                    username=config.user,
                    password=password,
                    protocol=PROTOCOLS[config.version],
                    will=last_will,
                    tls_context=context,
                    timeout=ANSWER_S,
                    keepalive=KEEPALIVE_S,
                    queue_type=_at_once(self._take),
                )
                async with time_limit(None), self._client as client:
                    await self._serve(client)
            except* (aiomqtt.MqttError, OSError, TimeoutError) as group:
                error = group.exceptions[0]
                while isinstance(error, BaseExceptionGroup):
                    error = error.exceptions[0]
                reason = str(error) or type(error).__name__
                status = self.status
                status.failed_attempts += not status.connected
                status.connected = False
                status.state = LinkState.HELD_OFF
                status.last_error = reason
                sentence = f"the broker {status.endpoint} is not reachable: {reason}"
                self._source.faults.refuse(
                    EdgeFault.NO_BROKER, "broker", sentence, time.monotonic_ns()
                )
            # the library keeps the socket of a connection that was not answered
            self._drop()
            if time.monotonic() - begun_s > LONGEST_PAUSE_S:
                pause_s = FIRST_PAUSE_S
            await asyncio.sleep(pause_s * random.uniform(0.8, 1.2))  # noqa: S311 -- no secret
            pause_s = min(2.0 * pause_s, LONGEST_PAUSE_S)

    def _drop(self) -> None:
        """Close an open socket without a message: the broker then publishes the last will.

        A proper disconnection withdraws the will; over an open socket the library would answer.
        """
        if self._client is not None:
            self._client._client._sock_close()

    async def _say(self, client: aiomqtt.Client, *, available: bool) -> None:
        self._status_number += 1
        text = payload.status(
            self._config, self._status_number, time.time_ns(), available=available
        )
        topic = payload.status_topic(self._config)
        await client.publish(topic, text, qos=self._config.qos, retain=True)

    async def _serve(self, client: aiomqtt.Client) -> None:
        try:
            # Birth message, metadata, then writes.
            await self._say(client, available=True)
            described = payload.metadata(
                self._config, self._collections, self._status_number
            )
            topic = payload.metadata_topic(self._config)
            qos = self._config.qos
            await client.publish(topic, described, qos=qos, retain=True)
            for topic in self._by_topic:
                await client.subscribe(topic, qos=qos)
            status = self.status
            now_ns = time.monotonic_ns()
            status.reconnects += status.last_connect_ns is not None
            status.connected = True
            status.state = LinkState.CONNECTED
            status.last_connect_ns = now_ns
            self._source.faults.admit()
            _log.info("databus connected", broker=status.endpoint)
            await together(self._send(client), _until_lost(client))
        except asyncio.CancelledError:
            try:
                async with time_limit(LEAVE_S):
                    await self._say(client, available=False)
            except (aiomqtt.MqttError, TimeoutError, asyncio.CancelledError):
                self._drop()
            raise

    # --- values out and in ------------------------------------------------------------------------

    async def _send(self, client: aiomqtt.Client) -> None:
        while True:
            await self._news.wait()
            self._news.clear()
            while self._waiting:
                index = next(iter(self._waiting))
                frame = self._waiting.pop(index)
                collection = self._collections[index]
                self._numbers[index] += 1
                utc_ns = self._world.clock.utc_ns(frame.planned_ns)
                text = payload.values(collection, frame, self._numbers[index], utc_ns)
                await client.publish(collection.topic, text, qos=self._config.qos)
                self.status.writes += 1

    def _take(self, message: aiomqtt.Message) -> None:
        collection = self._by_topic.get(message.topic.value)
        if collection is None or not isinstance(message.payload, bytes | bytearray):
            return
        if message.retain:
            why = "it is a retained message, so its age is unknown; publish writes without retain"
            self._refuse(collection, why)
        else:
            self._write(collection, bytes(message.payload))

    def _refuse(self, collection: Collection, why: str) -> None:
        name = collection.group.name
        sentence = f"a write to group '{name}' was refused: {why}"
        self._source.faults.report(
            EdgeFault.BAD_WRITE, name, sentence, time.monotonic_ns()
        )

    def _write(self, collection: Collection, data: bytes) -> None:
        now_ns = time.monotonic_ns()
        try:
            values = payload.written(collection, data)
        except ValueError as error:
            self._refuse(collection, str(error))
            return
        if values and not self._source.write(values, now_ns).wrong:
            self._source.staleness.renew(now_ns)
            self.status.input_received_ns.update(dict.fromkeys(values, now_ns))


def _at_once(take: Callable[[aiomqtt.Message], None]) -> type[asyncio.Queue[Any]]:
    """Return a queue that holds nothing: each message is taken as it is read.

    The socket is read one message at a time, between other work of the event loop; a faster stream
    waits at the broker, and nothing is lost here.
    """

    class AtOnce(asyncio.Queue[Any]):
        def put_nowait(self, item: Any) -> None:
            take(item)

    return AtOnce


async def _until_lost(client: aiomqtt.Client) -> None:
    """Wait until the connection ends, which raises MqttError."""
    async for _ in client.messages:
        pass
