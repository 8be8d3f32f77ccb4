"""Everything around the OPC UA server but the paced plant: image, gate, state machine, ticks."""

import time
import uuid
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from asyncua import Client, ua

from hilserver.config.root import Config
from hilserver.config.server import OpcUaConfig
from hilserver.core.clock import UtcClock
from hilserver.core.control import Control
from hilserver.core.events import EventBus
from hilserver.core.inputs import InputGate
from hilserver.core.leases import Leases
from hilserver.core.snapshot import SnapshotStore
from hilserver.image import ProcessImage, leases
from hilserver.image.leases import show_outcome
from hilserver.image.queues import latch_rows
from hilserver.image.requests import serve
from hilserver.image.ring import publish_frame
from hilserver.io.opcua_server.model import NAMESPACE_URI
from hilserver.io.opcua_server.server import OpcUaServer
from hilserver.plant.layout import WHEELS
from hilserver.signals import Ranges, SignalTable, robot_table
from hilserver.tasks import Supervisor

TABLE = robot_table(Ranges(max_rpm=90.0, max_linear_m_s=0.8, max_angular_rad_s=3.0))


@dataclass
class Clockwork:
    """Pacing by hand: what the state machine asked for, and the tick."""

    calls: list[str] = field(default_factory=list)
    tick: int = 0

    def pause(self) -> None:
        self.calls.append("pause")

    def resume(self) -> None:
        self.calls.append("resume")

    def step(self, n: int) -> None:
        self.calls.append(f"step {n}")

    def set_speed(self, factor: float) -> None:
        self.calls.append(f"speed {factor}")

    def reset_statistics(self) -> None:
        self.calls.append("reset_statistics")


class Rig:
    """A server whose plant ticks when the test says so; wheels reach their set-point at once."""

    def __init__(self, folder: Path, table: SignalTable = TABLE, **config: Any) -> None:
        self.table = table
        self.image = ProcessImage(
            f"hilserver-test-{uuid.uuid4().hex[:12]}",
            table,
            live={"state": 8},
            fixed={leases.REGION: leases.words_needed(8)},
            base_period_ns=1_000_000,
            ring_length=64,
            queue_rows=256,
        )
        self.events = EventBus()
        self.gate = InputGate(
            table,
            self.image,
            self.events,
            Leases(self.image),
            owner="peer",
            priority=("page", "opcua", "peer"),
        )
        self.pacing = Clockwork()
        self.snapshots = SnapshotStore(self.image, folder, {})
        self.control = Control(
            table,
            self.image,
            self.gate,
            self.events,
            self.pacing,
            self.snapshots,
            reset_statistics=self.pacing.reset_statistics,
        )
        self.clock = UtcClock()
        self.tables: dict[str, dict[str, dict[str, Any]]] = {
            "slices": {},
            "peers": {},
            "audit": {},
        }
        self.config = OpcUaConfig(
            **{"endpoint": "opc.tcp://127.0.0.1:0/hilserver", **config}
        )
        self.server = self.make_server()

    def make_server(self, **config: Any) -> OpcUaServer:
        changed = self.config.model_copy(update=config)
        world: Any = SimpleNamespace(
            config=Config().model_copy(update={"opcua": changed}),
            folder=None,
            table=self.table,
            image=self.image,
            gate=self.gate,
            control=self.control,
            events=self.events,
            clock=self.clock,
            tables={
                name: partial(self.tables.__getitem__, name) for name in self.tables
            },
            faults=None,
            parameters=None,
            files=None,
            tasks=Supervisor(),
        )
        return OpcUaServer(world)

    def tick(
        self, change: Callable[[Any, Any], None] | None = None, n: int = 1
    ) -> None:
        """Run `n` ticks; `change(values, status)` may alter the working frame of the last."""
        for _ in range(n):
            self._tick(change)
        frame = self.image.latest()
        assert frame is not None
        self.server.publish(frame)

    def _tick(self, change: Callable[[Any, Any], None] | None) -> None:
        image = self.image
        self.pacing.tick = (
            serve(image.control.request, self.pacing.tick, image.words) + 1
        )
        latch_rows(self.pacing.tick, image.values, image.words)
        show_outcome(image.values, image.words)
        values, status, slot = image.frame_values, image.frame_status, self.table.slot
        for wheel in WHEELS:
            values[slot(f"wheel.{wheel}.speed_rpm")] = values[
                slot(f"wheel.{wheel}.setpoint_rpm")
            ]
        values[slot("sim.tick")] = self.pacing.tick
        values[slot("sim.time_s")] = self.pacing.tick * 1e-3
        values[slot("sim.state")] = image.control.state
        if change is not None:
            change(values, status)
        publish_frame(self.pacing.tick, time.monotonic_ns(), image.values, image.words)

    def set(self, name: str, value: float, code: int = 0) -> None:
        """Run a tick in which the plant computes `value` for a signal."""
        slot = self.table.slot(name)

        def change(values: Any, status: Any) -> None:
            values[slot] = value
            status[slot] = code

        self.tick(change)

    async def close(self) -> None:
        await self.server.stop()
        self.image.close()


class RobotClient(Client):
    """asyncua's client that names our nodes by their path, and waits where the machine is busy."""

    def __init__(self, url: str) -> None:
        super().__init__(url, timeout=120, watchdog_intervall=3600)

    async def connect(self) -> None:
        await super().connect()
        self.index = await self.get_namespace_index(NAMESPACE_URI)

    def path(self, path: str) -> Any:
        return self.get_node(ua.NodeId(path, self.index))

    async def read(self, path: str) -> Any:
        return await self.path(path).read_value()

    async def data_value(self, path: str) -> ua.DataValue:
        return await self.path(path).read_data_value(raise_on_bad_status=False)

    async def write(self, *items: tuple[str, Any, ua.VariantType]) -> list[str]:
        """Write in one request; return the names of the status codes."""
        params = ua.WriteParameters()
        for path, value, kind in items:
            item = ua.WriteValue()
            item.NodeId = ua.NodeId(path, self.index)
            item.AttributeId = ua.AttributeIds.Value
            item.Value = ua.DataValue(ua.Variant(value, kind))
            params.NodesToWrite.append(item)
        return [code.name for code in await self.uaclient.write(params)]

    async def write_doubles(self, **values: float) -> list[str]:
        """Write doubles; ``__`` in a keyword stands for a dot."""
        kind = ua.VariantType.Double
        return await self.write(
            *((k.replace("__", "."), v, kind) for k, v in values.items())
        )

    async def call(self, name: str, *arguments: ua.Variant) -> ua.CallMethodResult:
        request = ua.CallMethodRequest()
        request.ObjectId = ua.NodeId("methods", self.index)
        request.MethodId = ua.NodeId(f"methods.{name}", self.index)
        request.InputArguments = list(arguments)
        return (await self.uaclient.call([request]))[0]


@asynccontextmanager
async def connected(rig: Rig) -> AsyncIterator[RobotClient]:
    client = RobotClient(rig.server.url)
    await client.connect()
    try:
        yield client
    finally:
        await client.disconnect()
