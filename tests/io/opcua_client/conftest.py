"""A peer in this process (a real asyncua server) and a link with everything it is given."""

import asyncio
import logging
import math
import time
from collections.abc import AsyncIterator, Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime

import pytest
import pytest_asyncio
from asyncua import Server, ua

from hilserver.config.peers import PeerConfig
from hilserver.core.clock import UtcClock
from hilserver.core.events import EventBus, EventKind
from hilserver.core.refusal import Refusal
from hilserver.faults import PeerLine
from hilserver.io.opcua_client import LinkSecurity, PeerLink
from hilserver.opcua.standard_nodes import QuickInternalServer
from tests.helpers.daemons import free_port

URI = "urn:iotbot:agv"
WHEELS = ("FL", "RL", "FR", "RR")


async def wait_until(condition: Callable[[], bool], timeout_s: float = 60.0) -> None:
    async with asyncio.timeout(timeout_s):
        while not condition():  # noqa: ASYNC110 - what is waited for is not an event
            await asyncio.sleep(0.005)


@dataclass
class RecordingGate:
    """Keeps what reached the door, and refuses what `refuse` says."""

    groups: list[dict[str, object]] = field(default_factory=list)
    refuse: dict[str, Refusal] = field(default_factory=dict)
    stale: list[str] = field(default_factory=list)
    news: list[Collection[str] | None] = field(default_factory=list)
    ages_ns: list[int] = field(default_factory=list)

    def write(
        self,
        source: str,
        values: Mapping[str, object],
        *,
        received_ns: int = 0,
        commanded_ns: int = 0,
        age_ns: int = 0,
        news: Collection[str] | None = None,
        renews: bool = True,
        by_hand: bool = False,
        broken: Collection[str] = (),
    ) -> dict[str, Refusal]:
        assert source == "peer:iot2050"
        self.news.append(news)
        self.ages_ns.append(age_ns)
        refused = {name: self.refuse[name] for name in values if name in self.refuse}
        self.groups.append({k: v for k, v in values.items() if k not in refused})
        return refused

    def expect(self, source: str, names: Iterable[str]) -> None:
        assert source == "peer:iot2050"

    def mark_stale(self, source: str) -> None:
        self.stale.append(source)

    @property
    def latest(self) -> dict[str, object]:
        merged: dict[str, object] = {}
        for group in self.groups:
            merged |= group
        return merged

    def values(self, name: str) -> list[object]:
        return [group[name] for group in self.groups if name in group]

    @property
    def all_finite(self) -> bool:
        return all(
            isinstance(v, int | float) and math.isfinite(v)
            for g in self.groups
            for v in g.values()
        )


@dataclass
class Harness:
    """A link and everything that it told."""

    link: PeerLink
    gate: RecordingGate
    events: EventBus
    stale: list[str]
    outputs: dict[str, tuple[object, int]]

    @property
    def status(self):
        return self.link.status

    @property
    def restored(self) -> list[str]:
        """Who delivered again after it had been lost."""
        found = [
            e.source for e in self.events.recent if e.kind is EventKind.PEER_RESTORED
        ]
        return found[1:]

    def heard(self, text: str) -> bool:
        return any(text in event.message for event in self.events.recent)


def make_harness(
    config: PeerConfig,
    line: PeerLine | None = None,
    security: LinkSecurity | None = None,
) -> Harness:
    gate, events = RecordingGate(), EventBus()
    outputs: dict[str, tuple[object, int]] = {}

    def read_output(name: str) -> tuple[object, int, int]:
        value, status = outputs.get(name, (0.0, 0))
        return value, status, time.monotonic_ns()

    link = PeerLink(
        config,
        gate=gate,
        events=events,
        read_output=read_output,
        clock=UtcClock(),
        line=line,
        security=security,
    )
    return Harness(link, gate, events, gate.stale, outputs)


def peer_config(port: int, **changes: object) -> PeerConfig:
    base: dict[str, object] = {
        "name": "iot2050",
        "endpoint": f"opc.tcp://127.0.0.1:{port}/UA/NodeRedAgv",
        "publishing_ms": 50,
        "poll_ms": 10,
        "stale_after_ms": 300,
        "sequence_node": f"nsu={URI};s=seq",
        "read": {
            f"nsu={URI};s=rpm_set_{wheel}": f"wheel.{wheel.lower()}.setpoint_rpm"
            for wheel in WHEELS
        },
    }
    return PeerConfig.model_validate(base | changes)


class Peer:
    """An asyncua server that offers set-points as the IOT2050 does."""

    def __init__(
        self, port: int, *, namespaces_before: int = 0, leave_out: tuple[str, ...] = ()
    ):
        self.port = port
        self._before = namespaces_before
        self._leave_out = leave_out
        self.sequence = 0

    async def start(self) -> "Peer":
        self.server = Server(iserver=QuickInternalServer())
        await self.server.init()
        self.server.set_endpoint(f"opc.tcp://127.0.0.1:{self.port}/UA/NodeRedAgv")
        self.server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        for index in range(self._before):
            await self.server.register_namespace(f"urn:other:{index}")
        self.namespace = await self.server.register_namespace(URI)
        self.nodes = {}
        names = [f"rpm_set_{w}" for w in WHEELS] + [f"rpm_act_{w}" for w in WHEELS]
        for name in names:
            if name not in self._leave_out:
                await self.add(name, 0.0, ua.VariantType.Double)
        await self.add("seq", 0, ua.VariantType.UInt32)
        await self.add("light", 0, ua.VariantType.Byte)
        await self.add("label", "", ua.VariantType.String)
        await self.add("read_only", 0.0, ua.VariantType.Double)
        await self.nodes["read_only"].set_read_only()
        await self.server.start()
        return self

    async def add(self, name: str, value: object, kind: ua.VariantType) -> None:
        node = await self.server.nodes.objects.add_variable(
            ua.NodeId(name, self.namespace), name, value, varianttype=kind
        )
        await node.set_writable()
        self.nodes[name] = node

    async def set(
        self, name: str, value: object, *, stamp: datetime | None = None, status=0
    ):
        kind = {"seq": ua.VariantType.UInt32, "light": ua.VariantType.Byte}.get(name)
        data = ua.DataValue(
            ua.Variant(value, kind),
            StatusCode=ua.StatusCode(ua.UInt32(status)),
            SourceTimestamp=stamp or datetime.now(UTC),
        )
        await self.server.write_attribute_value(self.nodes[name].nodeid, data)

    async def cycle(self, **values: float) -> None:
        for name, value in values.items():
            await self.set(name, value)
        self.sequence += 1
        await self.set("seq", self.sequence)

    async def run(self, period_s: float = 0.02) -> None:
        while True:
            await self.cycle(rpm_set_FL=float(self.sequence % 50))
            await asyncio.sleep(period_s)

    async def read(self, name: str) -> ua.DataValue:
        return await self.nodes[name].read_data_value(raise_on_bad_status=False)

    async def stop(self) -> None:
        await self.server.stop()
        # asyncua's server forgets two tasks for every session that it ends itself.
        forgotten = ("InternalSession.", "InternalSubscription.")
        left = [
            t
            for t in asyncio.all_tasks()
            if t.get_coro().__qualname__.startswith(forgotten)
        ]
        for task in left:
            task.cancel()
        await asyncio.gather(*left, return_exceptions=True)


@pytest.fixture(autouse=True)
def quiet_server():
    logging.getLogger("asyncua.server").setLevel(logging.CRITICAL + 1)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def shared_peer() -> AsyncIterator[Peer]:
    running = await Peer(free_port()).start()
    yield running
    await running.stop()


@pytest_asyncio.fixture(loop_scope="module")
async def peer(shared_peer: Peer) -> Peer:
    """One server per module, as it takes more than a second to start; fresh values per test."""
    for name in shared_peer.nodes:
        await shared_peer.set(
            name, "" if name == "label" else 0 if name in ("seq", "light") else 0.0
        )
    shared_peer.sequence = 0
    return shared_peer
