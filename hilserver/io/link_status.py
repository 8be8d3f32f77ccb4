"""What is known about the other end of a link, and what is wrong with it.

Filled by the link, read by everything that shows it. A fault is reported at its begin and end.
"""

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from enum import StrEnum

import structlog

from hilserver.compiled.histogram import Histogram125
from hilserver.core.events import Event, EventKind


class LinkState(StrEnum):
    """Where a link stands; `HELD_OFF` is the pause between two attempts."""

    STOPPED = "stopped"
    CONNECTING = "connecting"
    CONNECTED = "connected"
    HELD_OFF = "held_off"


@dataclass(slots=True)
class PeerStatus:
    """Everything observed on the link to one peer; durations not known yet are ``None``."""

    # as configured
    name: str
    endpoint: str = ""
    connected: bool = False  # a session exists and its heartbeat was answered
    state: LinkState = LinkState.STOPPED  # where the connection stands
    # how values come in: ``subscribe``, ``poll``; empty while not connected
    mode: str = ""
    mode_reason: str = ""  # why this mode, in words
    stale: bool = True  # inputs are older than `stale_after_ms`, or none has come yet
    last_connect_ns: int | None = None  # CLOCK_MONOTONIC [ns] of the newest session
    reconnects: int = 0  # sessions after the first one
    failed_attempts: int = 0  # attempts to connect that did not end in a session
    last_error: str = ""  # why the last session or attempt ended
    # heartbeat read of ServerStatus.CurrentTime, request to answer [ns]
    round_trip: Histogram125 = field(default_factory=Histogram125)
    # SourceTimestamp to arrival on our clock [ns], only from stamps that advance
    one_way: Histogram125 = field(default_factory=Histogram125)
    # between two arrivals of data [ns]
    interval: Histogram125 = field(default_factory=Histogram125)
    clock_offset_s: float | None = None  # peer's clock minus ours [s]
    # what the peer granted; sampling is the slowest of all nodes [ms]
    granted_publishing_ms: float | None = None
    granted_sampling_ms: float | None = None
    # sequence numbers that arrived, and that were left out between arrivals
    sequence_received: int = 0
    sequence_missed: int = 0
    polls_skipped: int = 0  # polls left out as the previous one was under way
    # multi-write calls answered, and cycles left out because the previous one was under way
    writes: int = 0
    writes_skipped: int = 0
    # signal -> CLOCK_MONOTONIC [ns] of its newest accepted value
    input_received_ns: dict[str, int] = field(default_factory=dict)
    # key (``nan_with_good:<node>``, ...) -> sentence; present while the fault lasts
    faults: dict[str, str] = field(default_factory=dict)
    # kind of fault -> how often it was seen, never reset
    fault_counts: Counter[str] = field(default_factory=Counter)

    @property
    def figures(self) -> dict[str, float | str | bool | int | None]:
        """Figures that OPC UA shows for this kind of link only."""
        return {}

    def input_age_s(self, now_ns: int) -> float | None:
        """Return the age [s] of the oldest input at `now_ns` (CLOCK_MONOTONIC); None: no input."""
        if not self.input_received_ns:
            return None
        return (now_ns - min(self.input_received_ns.values())) * 1e-9


HOLD_NS = 5_000_000_000  # a fault not seen for so long has ended

FAULTS_MAX = 64  # more different faults than this are counted but not listed

_log = structlog.get_logger(__name__)


class FaultBook:
    """Keeps `PeerStatus.faults`; an intermittent fault counts as one."""

    def __init__(
        self,
        status: PeerStatus,
        publish: Callable[[Event], None],
        kinds: Iterable[StrEnum] = (),
    ) -> None:
        # Counts exist before the first fault: the increase of a series begins at its first value.
        status.fault_counts.update(dict.fromkeys(map(str, kinds), 0))
        self._status = status
        self._publish = publish
        self._seen_ns: dict[str, int] = {}
        self._refusal: str | None = None

    def report(self, kind: StrEnum, subject: str, sentence: str, now_ns: int) -> None:
        """Note that `kind` was seen at `subject` (a node, a signal, a command)."""
        self._status.fault_counts[kind] += 1
        key = f"{kind}:{subject}"
        known = key in self._seen_ns
        if not known and len(self._seen_ns) >= FAULTS_MAX:
            return
        self._seen_ns[key] = now_ns
        if known:
            return
        self._status.faults[key] = sentence
        message = f"peer {self._status.name}: {sentence}"
        self._publish(
            Event(EventKind.PEER_FAULT, 500, self._status.name, message, now_ns)
        )

    def refuse(self, kind: StrEnum, subject: str, sentence: str, now_ns: int) -> None:
        """Note why there is no session; kept until `admit` or another reason."""
        key = f"{kind}:{subject}"
        if key != self._refusal:
            self.admit()
        self.report(kind, subject, sentence, now_ns)
        self._refusal = key if key in self._seen_ns else None

    def admit(self) -> None:
        """Remove the reason why there was no session."""
        if self._refusal is not None:
            self._end(self._refusal)
        self._refusal = None

    def expire(self, now_ns: int) -> None:
        """End the faults that have not been seen for `HOLD_NS`."""
        for key in [
            k for k, seen_ns in self._seen_ns.items() if now_ns - seen_ns > HOLD_NS
        ]:
            if key != self._refusal:
                self._end(key)

    def _end(self, key: str) -> None:
        del self._seen_ns[key]
        sentence = self._status.faults.pop(key)
        _log.info("peer fault ended", peer=self._status.name, what=sentence)
