"""What is known about who is at the other end of a link: filled by it, read by all who show it."""

from collections import Counter
from dataclasses import dataclass, field
from enum import StrEnum

from hilserver.compiled.histogram import Histogram125


class LinkState(StrEnum):
    """Where a link stands; `HELD_OFF` is the pause between two attempts."""

    STOPPED = "stopped"
    CONNECTING = "connecting"
    CONNECTED = "connected"
    HELD_OFF = "held_off"


@dataclass(slots=True)
class PeerStatus:
    """Everything observed on the link to one peer; durations unknown so far are ``None``."""

    # as configured
    name: str
    endpoint: str = ""
    connected: bool = False  # a session exists and its heartbeat was answered
    state: LinkState = LinkState.STOPPED  # where the connection stands
    mode: str = ""  # how values come in now: ``subscribe``, ``poll`` or empty while not connected
    mode_reason: str = ""  # why this mode, in words
    stale: bool = True  # inputs are older than `stale_after_ms`, or nothing has come from the peer
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
    polls_skipped: int = 0  # polls left out because the previous one was under way
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
        """What OPC UA shows of this kind of link alone."""
        return {}

    def input_age_s(self, now_ns: int) -> float | None:
        """Return the age [s] of the oldest input at `now_ns` (CLOCK_MONOTONIC); None: no input."""
        if not self.input_received_ns:
            return None
        return (now_ns - min(self.input_received_ns.values())) * 1e-9
