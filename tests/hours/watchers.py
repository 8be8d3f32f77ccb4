"""Users who only look, well and badly: subscriptions, floods, and clients that do not read."""

import asyncio
import contextlib
import itertools
import struct
from typing import Any

from asyncua import ua

from hilserver.config.s7 import Endpoint
from hilserver.io.s7.connection import S7Connection, S7Write
from hilserver.io.s7.wire import Item
from tests.hours.clock import CLOCK
from tests.hours.loop import NS
from tests.hours.town import OPCUA_PORT, PUBLISH_MS, S7_PORT
from tests.hours.users import LOST, User

FRESH_S = 1.0
QUEUE = 30
ENOUGH = 7  # steps, of which most show every frame
PUBLISHING_MS = 300.0
HOUR_MS = 3.6e6
LONGEST_LIFE_S = 900.0  # of what a client has left behind
MANY = 200
GREETINGS = (
    (OPCUA_PORT, b"HELF\x20\x00\x00\x00"),
    (S7_PORT, b"\x03\x00\x00\x16\x11\xe0"),
)


class _Seen:
    """What a subscription has brought."""

    def __init__(self) -> None:
        self.last_ns, self.ticks, self.events = CLOCK.now_ns, [], 0

    def datachange_notification(self, _node: Any, value: Any, _data: Any) -> None:
        self.last_ns = CLOCK.now_ns
        self.ticks.append(value)

    def event_notification(self, _event: Any) -> None:
        self.events += 1

    def status_change_notification(self, _status: Any) -> None:
        """Nothing is due."""


class Watcher(User):
    """Subscribes to the ticks and to events, and expects both to come."""

    acts = ((6, "watch"), (1, "cut"), (1, "vanish"), (1, "leave"), (2, "stop"))

    async def do_watch(self) -> None:
        """Watch for some seconds."""
        seen = _Seen()
        subscription = await self._client.create_subscription(PUBLISHING_MS, seen)
        tick = self._client.get_node(ua.NodeId("sim.tick", self.index))
        await subscription.subscribe_data_change(
            tick, queuesize=QUEUE, sampling_interval=0.0
        )
        if self.chance.random() < 0.5:
            await subscription.subscribe_events(evfilter=self._filter())
        begun_ns, transport = CLOCK.now_ns, self.transport
        for _ in range(self.chance.randint(4, 12)):
            await asyncio.sleep(0.25)
            if transport.is_closing() or self.is_over:
                return
            self._judge(seen, begun_ns)
        with contextlib.suppress(*LOST):
            await subscription.delete()

    def _filter(self) -> ua.EventFilter:
        """Return a filter that compares what cannot be compared."""
        select = ua.SimpleAttributeOperand()
        select.TypeDefinitionId = ua.NodeId(ua.ObjectIds.BaseEventType)
        select.BrowsePath = [ua.QualifiedName("Severity")]
        select.AttributeId = ua.AttributeIds.Value
        element = ua.ContentFilterElement()
        element.FilterOperator = ua.FilterOperator.GreaterThan
        literal = ua.LiteralOperand(ua.Variant(self.chance.choice(["text", 100, True])))
        element.FilterOperands = [select, literal]
        found = ua.EventFilter()
        found.SelectClauses = [select]
        found.WhereClause = ua.ContentFilter([element])
        return found

    def _judge(self, seen: _Seen, begun_ns: int) -> None:
        now_ns = CLOCK.now_ns
        disturbed_ns = self.town.disturbed_ns(now_ns - 4 * NS, now_ns)
        age_s = (now_ns - max(seen.last_ns, begun_ns) - disturbed_ns) / NS
        if age_s > FRESH_S and not self.town.has_stood(now_ns - 4 * NS):
            self.found.append(f"{self.name} has seen nothing new for {age_s:.1f} s")
        ticks = seen.ticks[-20:]
        steps = sorted(b - a for a, b in itertools.pairwise(ticks))
        if len(steps) >= ENOUGH and (usual := steps[len(steps) // 2]) > 2 * PUBLISH_MS:
            self.found.append(
                f"{self.name} sees only every {usual} ms of a queue of {QUEUE}"
            )


class Engineer(User):
    """Asks for much, leaves things behind, and does not read what it has asked for."""

    acts = (
        (2, "flood"), (2, "hour"), (1, "deaf"), (1, "stop"), (1, "reset"),
        (1, "force"), (1, "cut"), (1, "vanish"), (1, "leave"),
    )  # fmt: skip

    def _much(self) -> ua.ReadParameters:
        """Return a request whose answer is long."""
        asked, node = ua.ReadParameters(), ua.ReadValueId()
        node.NodeId = ua.NodeId(ua.ObjectIds.Server_NamespaceArray)
        node.AttributeId = ua.AttributeIds.Value
        asked.NodesToRead = MANY * [node]
        return asked

    async def do_flood(self) -> None:
        """Ask many things at once."""
        session, asked = self._client.uaclient.session, self._much()
        await asyncio.gather(
            *(session.read(asked) for _ in range(4)), return_exceptions=True
        )

    async def do_deaf(self) -> None:
        """Ask for much and read nothing of it; some time later, or never, read on."""
        session, asked, transport = (
            self._client.uaclient.session,
            self._much(),
            self.transport,
        )
        transport.pause_reading()
        questions = [asyncio.ensure_future(session.read(asked)) for _ in range(20)]
        await asyncio.sleep(self.chance.choice([1.0, 3.0]))
        if self.chance.random() < 0.5:
            transport.resume_reading()
        for question in questions:
            question.cancel()
        await asyncio.gather(*questions, return_exceptions=True)
        raise ConnectionError("enough")

    async def do_hour(self) -> None:
        """Subscribe with an interval of an hour, and leave it behind."""
        asked = ua.CreateSubscriptionParameters()
        asked.RequestedPublishingInterval = self.chance.choice([50.0, 1000.0, HOUR_MS])
        asked.RequestedLifetimeCount = self.chance.choice([10, 10_000, 2**31])
        asked.RequestedMaxKeepAliveCount = self.chance.choice([0, 10, 2**30])
        asked.PublishingEnabled = True
        session = self._client.uaclient.session
        result = await session.create_subscription(asked, lambda _answer: None)
        life_s = result.RevisedPublishingInterval * result.RevisedLifetimeCount / 1e3
        if life_s > LONGEST_LIFE_S:
            self.found.append(
                f"{self.name} may leave a subscription behind for {life_s:.0f} s"
            )
        with contextlib.suppress(*LOST):
            await session.close_session(False)
        raise ConnectionError("left")

    async def do_force(self) -> None:
        """Hold an output at a value, which moves nothing; a recording does not hold that."""
        if self.town.is_recorded:
            return
        await self.act("Force", "battery.voltage_v", 10.0)
        await asyncio.sleep(self.chance.uniform(0.1, 0.5))
        await self.act("Unforce", "battery.voltage_v")


class Panel(User):
    """A panel that reads and writes a data block over S7."""

    acts = (
        (6, "look"), (3, "note"), (1, "cut"), (1, "vanish"), (2, "freeze"), (1, "leave"),
    )  # fmt: skip

    async def connect(self) -> None:
        self._connection = S7Connection(Endpoint("127.0.0.1", S7_PORT, 0, 1))
        await self._connection.__aenter__()

    async def disconnect(self) -> None:
        await self._connection.__aexit__()

    @property
    def transport(self) -> Any:
        return self._connection._writer.transport

    async def do_look(self) -> None:
        """Look twice: time has passed."""
        begun_ns = CLOCK.now_ns
        first = await self._connection.read(1, 0, 4)
        await asyncio.sleep(self.chance.uniform(0.1, 0.5))
        second = await self._connection.read(1, 0, 4)
        if first == second and not self.town.has_stood(begun_ns):
            self.found.append(f"{self.name} reads the same tick again")

    async def do_note(self) -> None:
        """Write what was measured outside."""
        number = struct.pack(">f", self.chance.uniform(-1.0, 1.0))
        await self._connection.write([S7Write(Item(1, 8 * 4, 4), number)])


class Stranger(User):
    """Opens connections that never log in, and keeps them: drivers get in all the same."""

    async def live(self) -> None:
        """Open more and more."""
        while not self.is_over:
            for _ in range(self.chance.randint(5, 40)):
                with contextlib.suppress(OSError):
                    await self._open()
            await asyncio.sleep(self.chance.uniform(0.5, 5.0))

    async def _open(self) -> None:
        network = self.town.network
        port, begin = self.chance.choice(GREETINGS)
        end, _ = await network.connect(_Silent, "127.0.0.1", port)
        end.label = "stranger"
        if self.chance.random() < 0.5:
            end.write(begin[: self.chance.randint(1, len(begin))])
        if self.chance.random() < 0.3:
            network.vanish(end)


class _Silent(asyncio.Protocol):
    """Says nothing."""
