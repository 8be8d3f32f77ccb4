"""Users who do what they like: each a coroutine, drawn from the seed.

They use the product's own clients: asyncua as programs do, the page's hand as a browser does.
"""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from typing import Any

from asyncua import Client, ua

from hilserver.io.page.hand import Hand, RefusedError
from hilserver.io.page.setup import OpcUaAccess
from hilserver.io.peer_link.samples import LinkLostError, LinkRefusedError
from hilserver.io.s7.connection import AnswerError
from hilserver.time_limit import time_limit
from tests.control.clients import M_S_PER_RPM
from tests.hours.clock import CLOCK
from tests.hours.ledger import Act, Ledger, Speed
from tests.hours.loop import NS
from tests.hours.network import Mark, MemoryTransport
from tests.hours.town import HAND_LEASE_MS, OPCUA_LEASE_MS, OPCUA_PORT, PEER_PORT, Town

URL = f"opc.tcp://127.0.0.1:{OPCUA_PORT}/h"
ANSWER_S = 2.0
TYPES = {
    bool: ua.VariantType.Boolean,
    int: ua.VariantType.Byte,
    float: ua.VariantType.Double,
}
TYPES[str] = ua.VariantType.String
LOST = (
    *(OSError, TimeoutError, ua.UaError, RefusedError, asyncio.InvalidStateError),
    *(AnswerError, LinkLostError, LinkRefusedError),
)


class User:
    """Somebody with one connection, who comes, acts and goes."""

    kind, lease_ms, every_s = "opcua", OPCUA_LEASE_MS, 0.2
    is_hand = False
    acts: tuple[tuple[int, str], ...] = ()

    def __init__(self, name: str, town: Town, ledger: Ledger) -> None:
        self.name, self.town, self.ledger = name, town, ledger
        self.chance = town.chance_of(name)
        self.is_over = False
        self.is_frozen = False
        self.speed: Speed | None = None
        self.came = 0
        self.found: list[str] = []  # what it saw that must not be
        ledger.neutral.setdefault(name, [])

    # --- the connection ---------------------------------------------------------------------------

    async def connect(self) -> None:
        self._client = Client(URL, ANSWER_S, watchdog_intervall=3600)
        self._client.name, self._client.description = self.name, self.description
        await self._client.connect()
        self.index = await self._client.get_namespace_index("urn:hilserver:robot")

    description = "hours"

    @property
    def transport(self) -> MemoryTransport | None:
        protocol = self._protocol
        return None if protocol is None else protocol.transport

    @property
    def _protocol(self) -> Any:
        return self._client.uaclient.protocol

    async def disconnect(self) -> None:
        await self._client.disconnect()

    async def come(self) -> None:
        async with time_limit(4 * ANSWER_S):
            await self.connect()
        self.came += 1
        self.transport.label = self.name

    # --- what it says -----------------------------------------------------------------------------

    async def say(self, what: Awaitable[Any]) -> tuple[Mark | None, asyncio.Task[Any]]:
        """Send a request; return its place in the stream, and the task that waits."""
        task = asyncio.ensure_future(what)
        await asyncio.sleep(0)
        transport = self.transport
        return (None if transport is None else transport.mark()), task

    async def answer(self, task: asyncio.Task[Any]) -> Any:
        try:
            async with time_limit(ANSWER_S + 1):
                return await task
        finally:
            task.cancel()

    async def write(self, values: dict[str, Any]) -> None:
        nodes = [self._client.get_node(ua.NodeId(name, self.index)) for name in values]
        data = [ua.DataValue(ua.Variant(v, TYPES[type(v)])) for v in values.values()]
        await self._client.write_values(nodes, data)

    async def call(self, method: str, *arguments: Any) -> None:
        methods = self._client.get_node(ua.NodeId("methods", self.index))
        given = [
            ua.Variant(a, ua.VariantType.UInt32) if type(a) is int else a
            for a in arguments
        ]
        await methods.call_method(ua.NodeId(f"methods.{method}", self.index), *given)

    async def act(self, method: str, *arguments: Any) -> Act:
        """Call a method; the ledger knows when, and what became of it."""
        argument = arguments[0] if arguments else None
        act = Act(method, self.name, CLOCK.now_ns, argument=argument)
        self.ledger.acts.append(act)
        act.mark, task = await self.say(self.call(method, *arguments))
        try:
            await self.answer(task)
            act.is_accepted = True
        except (ua.UaStatusCodeError, RefusedError) as error:
            act.refusal = str(error)
            lost = "does not answer" in act.refusal
            act.is_accepted = None if lost else False
        finally:
            act.done_ns = CLOCK.now_ns
        return act

    async def command(self, rpm: float) -> Mark | None:
        values = {"drive.enable": True, "control.mode": 1, "twist.angular_rad_s": 0.0}
        mark, task = await self.say(
            self.write({**values, "twist.linear_m_s": rpm * M_S_PER_RPM})
        )
        if mark is not None:
            (self.speed.said if rpm else self.ledger.neutral[self.name]).append(mark)
        with contextlib.suppress(ua.UaStatusCodeError, RefusedError):
            await self.answer(task)
        return mark

    # --- life -------------------------------------------------------------------------------------

    async def live(self) -> None:
        """Come and go until it is told that it is over."""
        while not self.is_over:
            try:
                await self.come()
                while not self.is_over and not self.transport.is_closing():
                    await self._draw(self.acts)()
                    await asyncio.sleep(self.chance.uniform(0.05, 0.8))
            except (*LOST, AttributeError):  # AttributeError: its transport is gone
                pass
            await self.go()
            await asyncio.sleep(self.chance.uniform(0.1, 1.5))

    def _draw(self, acts: tuple[tuple[int, str], ...]) -> Callable[[], Awaitable[Any]]:
        names, weights = [name for _, name in acts], [weight for weight, _ in acts]
        return getattr(self, f"do_{self.chance.choices(names, weights)[0]}")

    async def go(self) -> None:
        with contextlib.suppress(*LOST, AttributeError):
            async with time_limit(ANSWER_S):
                await self.disconnect()
        with contextlib.suppress(AttributeError):
            self.transport.abort()

    async def do_cut(self) -> None:
        self.town.network.cut(self.transport)
        await asyncio.sleep(0.1)

    async def do_vanish(self) -> None:
        """Its computer is gone; another one comes later."""
        transport = self.transport
        transport.label = f"{self.name} before"
        self.town.network.vanish(transport)
        raise ConnectionError("gone")

    async def do_freeze(self) -> None:
        """Stand still, and go on."""
        await self._frozen(self.chance.choice([0.2, 1.0, 3.0]))

    async def _frozen(self, seconds: float) -> None:
        transport = self.transport
        self.town.network.freeze(transport)
        await asyncio.sleep(seconds)
        self.town.network.thaw(transport)

    async def do_leave(self) -> None:
        await self.disconnect()

    # --- driving ----------------------------------------------------------------------------------

    async def do_take(self) -> None:
        with contextlib.suppress(ua.UaStatusCodeError, RefusedError):
            await self.write({"control.source": self.kind})

    async def do_give(self) -> None:
        with contextlib.suppress(ua.UaStatusCodeError, RefusedError):
            await self.write({"control.source": self.chance.choice(["peer", "nobody"])})

    async def do_drive(self) -> None:
        """Hold a stick for a while."""
        await self._hold_stick(self.chance.randint(1, 12))
        if self.is_hand and self.chance.random() < 0.7:
            await self.command(0.0)

    async def _hold_stick(self, times: int) -> None:
        if self.is_hand and self.chance.random() < 0.7:
            await self.command(0.0)
        self.speed = self.ledger.new_speed(self.name, self.kind, self.lease_ms)
        for _ in range(times):
            await self.command(self.speed.rpm)
            await asyncio.sleep(self.every_s * self.chance.uniform(0.5, 1.2))

    async def do_return(self) -> None:
        """Drive, hand control over, and take it back without another word."""
        await self.do_take()
        await self._hold_stick(self.chance.randint(2, 4))
        await self.do_give()
        await asyncio.sleep(self.chance.uniform(0.0, 2.0))
        await self.do_take()
        await asyncio.sleep(self.chance.uniform(0.1, 1.0))

    async def do_stop(self) -> None:
        await self.act("Stop")

    async def do_reset(self) -> None:
        await self.act("Reset")

    async def do_start(self) -> None:
        await self.act("Start")

    async def do_pause(self) -> None:
        """Pause, perhaps step, and start again."""
        await self.act("Pause")
        await asyncio.sleep(self.chance.uniform(0.0, 0.3))
        if self.chance.random() < 0.3:
            await self.act("Step", 20)
        await self.act("Start")

    async def do_snapshot(self) -> None:
        """Save while it drives, load when it is silent, and see what moves then."""
        name = f"s{self.chance.randint(1, 3)}"
        if self.chance.random() < 0.8:
            await self.do_take()
            await self._hold_stick(3)
        await self.act("SaveSnapshot", name)
        await asyncio.sleep(self.chance.uniform(0.0, 1.0))
        await self.act("LoadSnapshot", name)
        await asyncio.sleep(self.chance.choice([0.1, 2.5]))


class Program(User):
    """A program as UaExpert or a PLC: it writes now and then."""

    acts = (
        (4, "take"), (8, "drive"), (1, "give"), (1, "stop"), (2, "reset"), (1, "start"),
        (3, "snapshot"), (3, "return"),
        (1, "cut"), (1, "vanish"), (1, "freeze"), (1, "leave"),
    )  # fmt: skip


class Terminal(User):
    """A person with the program `hilserver teleop`."""

    kind, lease_ms, every_s, is_hand = "opcua", HAND_LEASE_MS, 0.1, True
    description = "teleop hours"
    acts = (
        (4, "take"), (8, "drive"), (2, "return"), (1, "stop"), (2, "reset"),
        (1, "cut"), (1, "vanish"), (2, "freeze"), (1, "leave"),
    )  # fmt: skip


class Browser(User):
    """A person with the page: its hand, as the page's program has one for each browser."""

    kind, lease_ms, every_s, is_hand = "page", HAND_LEASE_MS, 0.1, True
    acts = (
        (4, "take"), (10, "drive"), (1, "give"), (2, "return"), (1, "stop"), (3, "reset"),
        (1, "pause"), (1, "snapshot"), (1, "cut"), (1, "vanish"), (2, "freeze"), (1, "leave"),
    )  # fmt: skip

    def __init__(self, name: str, town: Town, ledger: Ledger) -> None:
        super().__init__(name, town, ledger)
        secret = town.daemon.part("opcua").page_secret
        self._hand = Hand(OpcUaAccess(endpoint=URL, secret=secret), town.types)

    async def connect(self) -> None:
        await self._hand.connect()
        self._client = self._hand._client

    async def disconnect(self) -> None:
        await self._hand.close()

    async def write(self, values: dict[str, Any]) -> None:
        await self._hand.write(values)

    async def call(self, method: str, *arguments: Any) -> None:
        await self._hand.call(method, arguments)


class Controller:
    """The PLC: it offers set-points whether or not anybody follows them."""

    name = kind = "peer"

    def __init__(self, town: Town, ledger: Ledger) -> None:
        self.town, self.ledger, self.chance = town, ledger, town.chance_of("peer")
        self.is_over, self.is_silent, self._sequence = False, False, 0

    def change(self) -> None:
        """Offer another speed from now on."""
        self.speed = self.ledger.new_speed("peer", "peer", self.town.peer_lease_ms)

    async def offer(self) -> None:
        """Offer set-points again and again, unless it stands still."""
        self.change()
        while not self.is_over:
            if not self.is_silent:
                self._sequence += 1
                await self.town.offer(self.speed.rpm, self._sequence)
                self.speed.said_ns.append(CLOCK.now_ns)
            await asyncio.sleep(0.05)

    async def live(self) -> None:
        """Change, stand still, break off, start again."""
        while True:
            await asyncio.sleep(self.chance.uniform(0.2, 2.0))
            what = self.chance.choice(
                ["change"] * 6 + ["silent", "frozen", "cut", "refuse", "gone", "slow"]
            )
            if what == "change":
                self.change()
            elif what == "silent":
                self.is_silent = True
                await asyncio.sleep(self.chance.uniform(0.1, 1.5))
                self.is_silent = False
            else:
                await getattr(self, f"_{what}")()

    @property
    def _ends(self) -> list[MemoryTransport]:
        return [end for end in self.town.network.open if end.label == "controller"]

    async def _cut(self) -> None:
        for end in self._ends:
            self.town.network.cut(end)

    async def _frozen(self) -> None:
        network, ends = self.town.network, self._ends
        self.is_silent = True
        for end in ends:
            network.freeze(end)
        await asyncio.sleep(self.chance.choice([0.3, 1.0, 4.0]))
        for end in ends:
            network.thaw(end)
        self.is_silent = False

    async def _refuse(self) -> None:
        """Its program starts again."""
        await self._cut()
        with self.town.peer_refuses():
            await asyncio.sleep(self.chance.uniform(0.2, 3.0))

    async def _slow(self) -> None:
        """Its computer is busy: each answer comes late, but comes."""
        lags_ns = self.town.network.lags_ns
        await self._cut()
        lags_ns[PEER_PORT] = round(self.chance.uniform(0.8, 1.9) * NS)
        try:
            await asyncio.sleep(self.chance.uniform(2.0, 12.0))
        finally:
            del lags_ns[PEER_PORT]

    async def _gone(self) -> None:
        """Its computer is off the network; what it has said stays unanswered."""
        for end in self._ends:
            self.town.network.vanish(end)
        with self.town.peer_swallows():
            await asyncio.sleep(self.chance.uniform(0.5, 4.0))
