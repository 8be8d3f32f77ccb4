"""The link to one peer: a loop that connects, works and waits, for as long as the daemon runs."""

import asyncio
import time
from collections.abc import Callable, Iterator

import structlog
from asyncua import ua

from hilserver.config.peers import PeerConfig
from hilserver.core.clock import UtcClock
from hilserver.core.events import EventBus
from hilserver.faults.links import Lane, Line
from hilserver.io.opcua_client.acquisition import Acquisition
from hilserver.io.opcua_client.faulty_intake import FaultyIntake
from hilserver.io.opcua_client.intake import Intake
from hilserver.io.opcua_client.refusal import RefusedError
from hilserver.io.opcua_client.security import LinkSecurity
from hilserver.io.opcua_client.session import LinkLostError, Session
from hilserver.io.opcua_client.stamps import utc_ns_of
from hilserver.io.opcua_client.validation import FaultKind
from hilserver.io.opcua_client.writer import Output, Writer
from hilserver.io.part import Part
from hilserver.io.peer_status import LinkState, PeerStatus
from hilserver.io.source import Gate, Source
from hilserver.io.world import World
from hilserver.signals import MEASURED

HEARTBEAT_S = 1.0
WATCH_S = 0.02
HUNT_EVERY_S = 30.0
HUNT_STEP_S = 0.005
HUNT_READS_MAX = 300
SETTLED_S = 2.0
"""A session that lived so long resets the back-off."""

_log = structlog.get_logger(__name__)


class Backoff:
    """Pauses between attempts, measured from start to start, doubling up to a limit [s]."""

    def __init__(self, first_s: float = 0.1, limit_s: float = 0.5) -> None:
        self._first_s = first_s
        self._limit_s = limit_s
        self._next_s = first_s

    def settled(self) -> None:
        """Begin anew: the last session worked."""
        self._next_s = self._first_s

    def next_s(self) -> float:
        """Return the time from the start of this attempt to the start of the next one."""
        pause_s = self._next_s
        self._next_s = min(2 * pause_s, self._limit_s)
        return pause_s


class PeerLink(Part):
    """Reads set-points from one peer and writes outputs back, whatever the peer does.

    Parameters
    ----------
    config : PeerConfig
    gate : Gate
        Takes the groups of inputs.
    events : EventBus
    read_output : callable
        ``read_output(signal) -> (value, status code, monotonic_ns)`` of the newest frame.
    clock : UtcClock
        Turns ticks into SourceTimestamps and arrivals into UTC.
    line : Line or None
        Injected faults of this link.
    security : LinkSecurity or None
        Protects the sessions; None can only be given where the configuration asks for neither
        policy nor user.

    Attributes
    ----------
    status : PeerStatus
        Always up to date.
    """

    section = "peers"
    status: PeerStatus

    def __init__(
        self,
        config: PeerConfig,
        *,
        gate: Gate,
        events: EventBus,
        read_output: Callable[[str], Output],
        clock: UtcClock,
        line: Line | None = None,
        security: LinkSecurity | None = None,
    ) -> None:
        if security is None and (config.security.is_secure or config.security.user is not None):
            raise ValueError(f"peer '{config.name}' asks for a protected link")
        self.config, self.label = config, config.name
        self._security = security
        self.status = PeerStatus(config.name, config.endpoint)
        self._read_output = read_output
        self._clock = clock
        commanding = [name for name in config.inputs if not name.startswith(MEASURED)]
        self._source = Source(
            config.driver,
            f"peer {config.name}",
            self.status,
            gate,
            events.publish,
            fresh=lambda: f"peer {config.name} delivers fresh values",
            commanding=commanding,
        )
        self._faults = self._source.faults
        self._intake = Intake(config, self._source, clock.utc_ns)
        self._line = line or Line(config.name)
        self._tasks: list[asyncio.Task[None]] = []

    @property
    def address(self) -> str:
        """Whom it reaches."""
        return self.config.endpoint

    async def start(self) -> None:
        """Start connecting; returns at once, the peer may come later."""
        if self._tasks:
            return
        self._source.expect(self.config.inputs)
        self.status.state = LinkState.CONNECTING
        self._tasks = [
            asyncio.create_task(self._run(), name=f"peer-{self.config.name}"),
            asyncio.create_task(self._watch(), name=f"peer-{self.config.name}-watch"),
        ]

    async def stop(self) -> None:
        """Close the session and end; limited by the session's close time."""
        tasks, self._tasks = self._tasks, []
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        self.status.state = LinkState.STOPPED

    async def _watch(self) -> None:
        while True:
            now_ns = time.monotonic_ns()
            if self.config.read:
                self._source.watch(now_ns)
            else:
                self.status.stale = False
                self._faults.expire(now_ns)
            await asyncio.sleep(WATCH_S)

    async def _run(self) -> None:
        backoff = Backoff()
        loop = asyncio.get_running_loop()
        while True:
            started_s = loop.time()
            self.status.state = LinkState.CONNECTING
            await self._line.wait_whole()
            shortest_s = 0.02
            try:
                async with Session(self.config.endpoint, self._security) as session:
                    await self._work(session)
            except Exception as error:  # noqa: BLE001 - a broken peer can make the library raise anything
                refused = refusal_in(error)
                if refused is None:
                    self._note_end(error)
                else:
                    self._note_refusal(refused)
                    shortest_s = refused.pause_s
            if self.status.connected and loop.time() - started_s > SETTLED_S:
                backoff.settled()
            self._leave_session()
            if not self._tasks:
                return  # stopped: an error of the same moment has hidden the cancellation
            pause_s = started_s + backoff.next_s() - loop.time()
            await asyncio.sleep(max(shortest_s, pause_s))

    async def _work(self, session: Session) -> None:
        status, now_ns = self.status, time.monotonic_ns()
        self._intake.begin_session()
        await session.read_clock()
        self._enter_session()
        intake = FaultyIntake(self._intake, self._line)
        acquisition = Acquisition(session, self.config, status, intake, self._report_slow)
        self._intake.expect(acquisition.nodes, now_ns)
        writer = Writer(
            session,
            self.config,
            status,
            self._faults,
            self._read_output,
            self._clock.utc,
            Lane(self._line, "out"),
        )
        async with asyncio.TaskGroup() as group:
            group.create_task(session.wait_lost())
            group.create_task(session.watch_trust())
            group.create_task(self._wait_cut())
            group.create_task(intake.run())
            group.create_task(self._heartbeat(session))
            group.create_task(writer.run())
            group.create_task(acquisition.run())

    async def _wait_cut(self) -> None:
        await self._line.wait_cut()
        raise LinkLostError("an injected fault cut the link")

    def _enter_session(self) -> None:
        status = self.status
        if status.last_connect_ns is not None:
            status.reconnects += 1
        status.last_connect_ns = time.monotonic_ns()
        status.connected, status.state = True, LinkState.CONNECTED
        self._faults.admit()
        _log.info("peer connected", peer=self.config.name, endpoint=self.config.endpoint)

    def _leave_session(self) -> None:
        status = self.status
        if not status.connected:
            status.failed_attempts += 1
        status.connected, status.state = False, LinkState.HELD_OFF
        status.mode = status.mode_reason = ""

    def _note_end(self, error: Exception) -> None:
        why = describe(error)
        if self.status.connected or why != self.status.last_error:
            _log.warning("peer link ended", peer=self.config.name, why=why)
        self.status.last_error = why

    def _note_refusal(self, refused: RefusedError) -> None:
        """Tell the reason once, however often the attempt is repeated."""
        self.status.last_error = str(refused)
        self._faults.refuse(refused.kind, refused.subject, str(refused), time.monotonic_ns())

    def _report_slow(self, sentence: str) -> None:
        now_ns = time.monotonic_ns()
        self._faults.report(FaultKind.SLOW_RATE, self.config.name, sentence, now_ns)

    async def _heartbeat(self, session: Session) -> None:
        """Measure round trip and clock offset; a heart that stops ends the session by timeout."""
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

    async def _read_clock(self, session: Session) -> bool:
        sent_ns = time.monotonic_ns()
        peer_ns = utc_ns_of(await session.read_clock())
        received_ns = time.monotonic_ns()
        self.status.round_trip.observe(received_ns - sent_ns)
        if peer_ns is None:
            return False
        utc_ns = self._clock.utc_ns
        return self._intake.offset.read(utc_ns(sent_ns), utc_ns(received_ns), peer_ns)


def parts(world: World) -> Iterator[PeerLink]:
    """Yield a link for every configured peer."""
    for index, peer in enumerate(world.config.peers):
        with world.at("peers", index):
            security = LinkSecurity(peer, world.config.opcua, world.folder)
        yield PeerLink(
            peer,
            gate=world.gate,
            events=world.events,
            read_output=world.read_output,
            clock=world.clock,
            line=world.lines[peer.name],
            security=security,
        )


def refusal_in(error: BaseException) -> RefusedError | None:
    """Return the refusal that ended a session or an attempt, None if it was something else."""
    if isinstance(error, BaseExceptionGroup):
        return next(filter(None, map(refusal_in, error.exceptions)), None)
    return error if isinstance(error, RefusedError) else None


def describe(error: BaseException) -> str:
    """Return in words why a session or an attempt ended."""
    if isinstance(error, BaseExceptionGroup):
        return describe(error.exceptions[0])
    if isinstance(error, LinkLostError):
        return str(error)
    if isinstance(error, TimeoutError):
        return "no answer in time"
    if isinstance(error, ConnectionRefusedError):
        return "nobody listens there"
    if isinstance(error, ua.UaStatusCodeError):
        return f"the peer answered {error.__class__.__name__}"
    if isinstance(error, OSError):
        return error.strerror or str(error) or "the connection broke"
    return f"{error.__class__.__name__}: {error}"
