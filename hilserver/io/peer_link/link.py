"""A controller that we reach as a client: connect, work, wait, as long as the daemon runs.

One `Peer` protocol, several transports: a transport adds `converse`, which lasts until the
connection ends. Silence, faults, back-off and figures are the same for all.
"""

import asyncio
import time
from collections.abc import Callable, Iterable

import structlog

from hilserver.config.peers import PeerConfig
from hilserver.core.clock import UtcClock
from hilserver.core.events import EventBus
from hilserver.core.inputs import InputGate
from hilserver.faults.links import PeerLine
from hilserver.io.arrival import WATCH_S
from hilserver.io.link_status import LinkState, PeerStatus
from hilserver.io.peer_link.intake import FaultyIntake, Intake
from hilserver.io.peer_link.samples import (
    FaultKind,
    LinkLostError,
    refusal_in,
)
from hilserver.io.source import Source
from hilserver.io.world import Part
from hilserver.signals import MEASURED
from hilserver.tasks import SupervisedTask, Supervisor
from hilserver.time_limit import time_limit

SETTLED_S = 2.0  # a session of this length resets the back-off

Output = tuple[object, int, int]
"""Value, OPC UA status code, CLOCK_MONOTONIC [ns] of the tick that made it."""

_log = structlog.get_logger(__name__)


class Backoff:
    """Pauses between attempts, measured from start to start, doubling up to a limit [s]."""

    def __init__(self, first_s: float = 0.1, limit_s: float = 0.5) -> None:
        self._first_s = first_s
        self._limit_s = limit_s
        self._next_s = first_s

    def settled(self) -> None:
        """Reset the pauses: the last session worked."""
        self._next_s = self._first_s

    def next_s(self) -> float:
        """Return the time from the start of this attempt to the start of the next one."""
        pause_s = self._next_s
        self._next_s = min(2 * pause_s, self._limit_s)
        return pause_s


class Peer(Part):
    """Reads set-points from one peer and writes outputs back, whatever the peer does.

    Parameters
    ----------
    gate : InputGate
        Takes the groups of inputs.
    read_output : callable
        ``read_output(signal) -> (value, status code, monotonic_ns)`` of the newest frame.
    clock : UtcClock
        Turns ticks into SourceTimestamps and arrivals into UTC.
    line : Line or None
        Injected faults of this link.
    tasks : Supervisor or None
        Keeps the link's tasks.
    """

    section = "peers"
    kinds: Iterable[FaultKind] = FaultKind  # of faults that the transport can have
    status: PeerStatus  # always up to date

    def __init__(
        self,
        config: PeerConfig,
        *,
        gate: InputGate,
        events: EventBus,
        read_output: Callable[[str], Output],
        clock: UtcClock,
        line: PeerLine | None = None,
        tasks: Supervisor | None = None,
    ) -> None:
        self.config = config
        self.label = config.name
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
            kinds=self.kinds,
        )
        self._faults = self._source.faults
        self._intake = Intake(config, self._source, clock.utc_ns)
        self._line = line or PeerLine(config.name)
        self._tasks = Supervisor() if tasks is None else tasks
        self._jobs: list[SupervisedTask] = []

    async def converse(self) -> None:
        """Connect, call `enter`, and work until the connection ends; raise the reason."""
        raise NotImplementedError

    @staticmethod
    def describe(error: BaseException) -> str:
        """Return in words why a session or an attempt ended."""
        return describe(error)

    @property
    def address(self) -> str:
        """The peer that it connects to."""
        return self.config.endpoint

    async def start(self) -> None:
        """Start connecting; returns at once, the peer may come later."""
        if self._jobs:
            return
        self._source.expect(self.config.inputs)
        self.status.state = LinkState.CONNECTING
        name = f"peer {self.config.name}"
        self._jobs = [
            self._tasks.keep(name, self._run),
            self._tasks.every(f"{name}: watch", WATCH_S, self._look),
        ]

    async def stop(self) -> None:
        """Close the session and end; limited by the session's close time."""
        jobs = self._jobs
        self._jobs = []
        for job in jobs:
            await job.end()
        self.status.state = LinkState.STOPPED

    def _look(self) -> None:
        now_ns = time.monotonic_ns()
        if self.config.read:
            self._source.watch(now_ns)
        else:
            self.status.stale = False
            self._faults.expire(now_ns)

    async def _run(self) -> None:
        backoff = Backoff()
        loop = asyncio.get_running_loop()
        while True:
            started_s = loop.time()
            self.status.state = LinkState.CONNECTING
            await self._line.wait_whole()
            shortest_s = 0.02
            try:
                self._intake.begin_session()
                async with time_limit(
                    None
                ):  # what a library cancels itself must not end this task
                    await self.converse()
            except Exception as error:  # noqa: BLE001 - a broken peer can make a library raise anything
                refused = refusal_in(error)
                if refused is None:
                    why = self.describe(error)
                    if self.status.connected or why != self.status.last_error:
                        _log.warning("peer link ended", peer=self.config.name, why=why)
                    self.status.last_error = why
                else:
                    # Reported once, however often the attempt is repeated.
                    self.status.last_error = str(refused)
                    self._faults.refuse(
                        refused.kind, refused.subject, str(refused), time.monotonic_ns()
                    )
                    shortest_s = refused.pause_s
            if self.status.connected and loop.time() - started_s > SETTLED_S:
                backoff.settled()
            status = self.status
            if not status.connected:
                status.failed_attempts += 1
            status.connected = False
            status.state = LinkState.HELD_OFF
            status.mode = status.mode_reason = ""
            if not self._jobs:
                # stopped: an error at the same moment has hidden the cancellation
                return
            pause_s = started_s + backoff.next_s() - loop.time()
            await asyncio.sleep(max(shortest_s, pause_s))

    async def wait_cut(self) -> None:
        """Wait until an injected fault cuts the link."""
        await self._line.wait_cut()
        raise LinkLostError("an injected fault cut the link")

    def enter(self) -> FaultyIntake:
        """Note that there is a session; return the intake for its samples."""
        status = self.status
        if status.last_connect_ns is not None:
            status.reconnects += 1
        status.last_connect_ns = time.monotonic_ns()
        status.connected = True
        status.state = LinkState.CONNECTED
        self._faults.admit()
        _log.info(
            "peer connected", peer=self.config.name, endpoint=self.config.endpoint
        )
        return FaultyIntake(self._intake, self._line)


def describe(error: BaseException) -> str:
    """Return in words why a session or an attempt ended."""
    if isinstance(error, BaseExceptionGroup):
        return describe(error.exceptions[0])
    if isinstance(error, LinkLostError):
        return str(error)
    if isinstance(error, TimeoutError):
        return "no answer in time"
    if isinstance(error, ConnectionRefusedError):
        return "nothing is listening there"
    if isinstance(error, OSError):
        return error.strerror or str(error) or "the connection broke"
    return f"{error.__class__.__name__}: {error}"
