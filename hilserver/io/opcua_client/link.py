"""An OPC UA peer: one session after another."""

import asyncio
import time
from typing import Any

from asyncua import ua

from hilserver.config.peers import PeerConfig
from hilserver.faults.links import Lane
from hilserver.io.opcua_client.acquisition import Acquisition
from hilserver.io.opcua_client.security import LinkSecurity
from hilserver.io.opcua_client.session import PeerSession, utc_ns_of
from hilserver.io.opcua_client.writer import PeerWriter
from hilserver.io.peer_link.link import Peer, describe
from hilserver.io.peer_link.samples import OF_OPCUA, FaultKind
from hilserver.tasks import together

HEARTBEAT_S = 1.0
HUNT_EVERY_S = 30.0
HUNT_STEP_S = 0.005
HUNT_READS_MAX = 300


class PeerLink(Peer):
    """Reads and writes the variables of an OPC UA server.

    Parameters
    ----------
    security : LinkSecurity or None
        Protects the sessions; None only if the configuration has neither policy nor user.
    """

    def __init__(
        self, config: PeerConfig, *, security: LinkSecurity | None = None, **around: Any
    ) -> None:
        if security is None and (
            config.security.is_secure or config.security.user is not None
        ):
            raise ValueError(f"peer '{config.name}' asks for a protected link")
        # Without security nothing is asked of certificates and users.
        if security:
            self.kinds = OF_OPCUA
        else:
            self.kinds = OF_OPCUA - {FaultKind.CERTIFICATE, FaultKind.LOG_IN}
        super().__init__(config, **around)
        self._security = security

    async def converse(self) -> None:
        """Hold one session."""
        async with PeerSession(self.config.endpoint, self._security) as session:
            status = self.status
            now_ns = time.monotonic_ns()
            await session.read_clock()
            intake = self.enter()
            acquisition = Acquisition(
                session, self.config, status, intake, self._report_slow
            )
            self._intake.expect(acquisition.nodes, now_ns)
            writer = PeerWriter(
                session,
                self.config,
                status,
                self._faults,
                self._read_output,
                self._clock.utc,
                Lane(self._line, "out"),
            )
            ways = [
                session.wait_lost(),
                session.watch_trust(),
                self.wait_cut(),
                intake.run(),
                self._heartbeat(session),
            ]
            if self.config.write:
                ways.append(writer.run())
            if acquisition.nodes:
                ways.append(acquisition.run())
            await together(*ways)

    @staticmethod
    def describe(error: BaseException) -> str:
        """Return in words why a session or an attempt ended."""
        if isinstance(error, BaseExceptionGroup):
            return PeerLink.describe(error.exceptions[0])
        if isinstance(error, ua.UaStatusCodeError):
            return f"the peer answered {error.__class__.__name__}"
        return describe(error)

    def _report_slow(self, sentence: str) -> None:
        now_ns = time.monotonic_ns()
        self._faults.report(FaultKind.SLOW_RATE, self.config.name, sentence, now_ns)

    async def _heartbeat(self, session: PeerSession) -> None:
        """Measure round trip and clock offset; a missing answer ends the session by timeout."""
        offset = self._intake.offset
        hunt_at_s = 0.0
        while True:
            await self._read_clock(session)
            found = await self._read_clock(session)
            if not found and time.monotonic() >= hunt_at_s:
                hunt_at_s = time.monotonic() + HUNT_EVERY_S
                for _ in range(HUNT_READS_MAX):
                    await asyncio.sleep(HUNT_STEP_S)
                    if await self._read_clock(session):
                        break
            if offset.offset_ns is not None:
                self.status.clock_offset_s = offset.offset_ns * 1e-9
            await asyncio.sleep(HEARTBEAT_S)

    async def _read_clock(self, session: PeerSession) -> bool:
        sent_ns = time.monotonic_ns()
        peer_ns = utc_ns_of(await session.read_clock())
        received_ns = time.monotonic_ns()
        self.status.round_trip.observe(received_ns - sent_ns)
        if peer_ns is None:
            return False
        utc_ns = self._clock.utc_ns
        return self._intake.offset.read(utc_ns(sent_ns), utc_ns(received_ns), peer_ns)
