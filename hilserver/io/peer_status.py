"""What is known about one OPC UA peer: filled by its link, read by everyone who shows it."""

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
    """Everything observed on the link to one peer; durations unknown so far are ``None``.

    Attributes
    ----------
    name, endpoint : str
        As configured.
    connected : bool
        A session exists and its heartbeat was answered.
    state : LinkState
        Where the connection stands.
    mode : str
        How values come in now: ``subscribe``, ``poll`` or empty while not connected.
    mode_reason : str
        Why this mode, in words.
    stale : bool
        Inputs are older than `stale_after_ms`, or the peer was never heard.
    last_connect_ns : int or None
        CLOCK_MONOTONIC [ns] of the newest session.
    reconnects : int
        Sessions after the first one.
    failed_attempts : int
        Attempts to connect that did not end in a session.
    last_error : str
        Why the last session or attempt ended.
    round_trip : Histogram125
        Heartbeat read of ServerStatus.CurrentTime, request to answer [ns].
    one_way : Histogram125
        SourceTimestamp to arrival on our clock [ns], only from stamps that advance.
    interval : Histogram125
        Between two arrivals of data [ns].
    clock_offset_s : float or None
        Peer's clock minus ours [s].
    granted_publishing_ms, granted_sampling_ms : float or None
        What the peer granted; sampling is the slowest of all nodes [ms].
    sequence_received, sequence_missed : int
        Sequence numbers that arrived, and that were left out between arrivals.
    polls_skipped : int
        Polls left out because the previous one was under way.
    writes, writes_skipped : int
        Multi-write calls answered, and cycles left out because the previous one was under way.
    input_received_ns : dict of str to int
        Signal -> CLOCK_MONOTONIC [ns] of its newest accepted value.
    faults : dict of str to str
        Key (``nan_with_good:<node>``, ...) -> sentence; present while the fault lasts.
    fault_counts : Counter
        Kind of fault -> how often it was seen, never reset.
    """

    name: str
    endpoint: str = ""
    connected: bool = False
    state: LinkState = LinkState.STOPPED
    mode: str = ""
    mode_reason: str = ""
    stale: bool = True
    last_connect_ns: int | None = None
    reconnects: int = 0
    failed_attempts: int = 0
    last_error: str = ""
    round_trip: Histogram125 = field(default_factory=Histogram125)
    one_way: Histogram125 = field(default_factory=Histogram125)
    interval: Histogram125 = field(default_factory=Histogram125)
    clock_offset_s: float | None = None
    granted_publishing_ms: float | None = None
    granted_sampling_ms: float | None = None
    sequence_received: int = 0
    sequence_missed: int = 0
    polls_skipped: int = 0
    writes: int = 0
    writes_skipped: int = 0
    input_received_ns: dict[str, int] = field(default_factory=dict)
    faults: dict[str, str] = field(default_factory=dict)
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
