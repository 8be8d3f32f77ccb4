"""The server as a part of the daemon: frames out, groups through the gate."""

import time
from collections.abc import Collection, Mapping
from typing import Final

from hilserver.config.s7 import S7Server
from hilserver.core.refusal import Refusal
from hilserver.core.staleness import Transition
from hilserver.errors import address_refused
from hilserver.image import Frame
from hilserver.io.arrival import WATCH_S
from hilserver.io.link_status import LinkState, PeerStatus
from hilserver.io.peer_link.samples import FaultKind
from hilserver.io.s7.blocks import blocks_of
from hilserver.io.s7.server import Answers, Server
from hilserver.io.s7.wire import Code
from hilserver.io.source import Source
from hilserver.io.world import Part, World
from hilserver.tasks import SupervisedTask

CODES: Final[Mapping[Refusal, Code]] = {Refusal.TYPE_MISMATCH: Code.UNFIT}
"""Codes for refusals; all others have nothing to do with the address: denied."""


class S7Link(Part):
    """Data blocks for controllers and panels."""

    section, label = "s7", "S7"
    # `connected` while there is a client; `writes` counts accepted jobs
    status: PeerStatus

    def __init__(self, config: S7Server, world: World) -> None:
        self._config, self._world = config, world
        driver = world.config.s7.driver
        self.status = PeerStatus(
            "s7", f"s7://{config.host}:{config.port}", mode="put/get"
        )
        self.status.stale = world.config.s7.drives
        with world.at("s7", "server", "blocks"):
            self._blocks = blocks_of(config, world.table)
        self._source = Source(
            driver,
            "S7",
            self.status,
            world.gate,
            world.events.publish,
            fresh=lambda: "S7: a client writes",
            kinds=(FaultKind.NO_ROOM, FaultKind.NO_S7),
        )
        self._server = Server(config, self._answers, self._report, world.tasks)
        self._watching: SupervisedTask | None = None
        self._frame: Frame | None = None
        self._contents: Mapping[int, bytes] = {
            n: bytes(b.size) for n, b in self._blocks.items()
        }

    @property
    def address(self) -> str:
        """Where it listens."""
        return f"s7://{self._config.host}:{self._server.port}"

    async def start(self) -> None:
        """Listen; FailedError if the port is not available."""
        try:
            await self._server.start()
        except OSError as error:
            where = f"{self._config.host} port {self._config.port}"
            raise address_refused(
                f"s7.server: cannot listen on {where}", error
            ) from None
        self.status.endpoint, self.status.state = self.address, LinkState.CONNECTING
        self._watching = self._world.tasks.every("s7: watch", WATCH_S, self._look)

    async def stop(self) -> None:
        """Close all connections and stop listening."""
        if self._watching is not None:
            self._watching.cancel()
        await self._server.stop()
        self.status.state = LinkState.STOPPED

    def _look(self) -> None:
        """Check for silence of the writers."""
        status, now_ns = self.status, time.monotonic_ns()
        status.connected = bool(self._server.clients)
        status.state = LinkState.CONNECTED if status.connected else LinkState.CONNECTING
        if self._world.config.s7.drives:
            self._source.watch(now_ns)
        else:
            self._source.faults.expire(now_ns)
            if self._source.staleness.check(now_ns) is Transition.LOST:
                self._world.gate.let_go(self._source.name)

    # --- what a client asks -----------------------------------------------------------------------

    def _answers(self) -> Answers:
        status = self.status
        status.reconnects += status.last_connect_ns is not None
        status.last_connect_ns = time.monotonic_ns()
        return Answers(self._blocks, self._config.pdu_bytes, self._newest, self._write)

    def _newest(self) -> Mapping[int, bytes]:
        """Return all blocks of the newest frame; each frame is packed once."""
        frame = self._world.image.latest()
        if frame is not None and (
            self._frame is None or frame.number != self._frame.number
        ):
            frame.values[self._world.table.slot("sim.state")] = (
                self._world.control.state
            )
            self._frame = frame
            self._contents = {
                n: block.filled(frame) for n, block in self._blocks.items()
            }
        return self._contents

    def _write(
        self, values: Mapping[str, object], broken: Collection[str]
    ) -> Mapping[str, Code]:
        now_ns = time.monotonic_ns()
        outcome = self._source.write(values, now_ns, broken=broken)
        if not outcome.wrong:
            self._source.staleness.renew(now_ns)
            self.status.input_received_ns.update(dict.fromkeys(values, now_ns))
            self.status.writes += 1
        return {
            name: CODES.get(why, Code.DENIED) for name, why in outcome.refused.items()
        }

    def _report(self, kind: FaultKind, host: str, sentence: str) -> None:
        self._source.faults.report(kind, host, sentence, time.monotonic_ns())
