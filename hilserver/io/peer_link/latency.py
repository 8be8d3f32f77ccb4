"""Clock offset and one-way latency from time stamps of a peer: pure, in nanoseconds.

The offset comes from pairs of reads of ServerStatus.CurrentTime, NTP's way: the read with the
smallest uncertainty counts. Some servers update CurrentTime in steps (asyncua: one second), and a
value that is up to a step old is useless. Two reads in a row distinguish the two kinds::

    fresh clock:    |--read--|  |--read--|      advance of the clock = time between the reads
                        t1          t2          offset = t2 - middle of the second read

    stepped clock:  |--read--|  |--read--|      unchanged: the caller reads on until it steps
                        t1          t1
                    |--read--|  |--read--|      the step lies between the two:
                        t1          t1 + step   offset = new value - middle of both reads
"""

from collections import deque
from dataclasses import dataclass

from hilserver.io.peer_link.samples import FaultKind

PAIR_NS = 50_000_000  # two reads further apart than this are not a pair

FRESH_NS = 2_000_000
"""Largest difference of the advances of a fresh clock and ours between two reads."""


@dataclass(frozen=True, slots=True)
class _Read:
    sent_ns: int
    received_ns: int
    peer_ns: int


class ClockOffset:
    """Peer's clock minus ours: the most certain estimate of the newest ones."""

    def __init__(self, window: int = 32) -> None:
        self._estimates: deque[tuple[int, int]] = deque(maxlen=window)
        self._last: _Read | None = None

    def read(self, sent_ns: int, received_ns: int, peer_ns: int) -> bool:
        """Add one read; all three in UTC [ns]. Return whether it gave an estimate."""
        last = self._last
        self._last = _Read(sent_ns, received_ns, peer_ns)
        if last is None or received_ns - last.sent_ns > PAIR_NS:
            return False
        advance_ns = peer_ns - last.peer_ns
        elapsed_ns = received_ns - last.received_ns
        if advance_ns == 0:
            return False
        if abs(advance_ns - elapsed_ns) <= FRESH_NS:
            self._add(sent_ns, received_ns, peer_ns)
        else:
            self._add(last.sent_ns, received_ns, peer_ns)
        return True

    def _add(self, earliest_ns: int, latest_ns: int, peer_ns: int) -> None:
        middle_ns = (earliest_ns + latest_ns) // 2
        self._estimates.append(((latest_ns - earliest_ns) // 2, peer_ns - middle_ns))

    @property
    def offset_ns(self) -> int | None:
        """Peer minus ours [ns]; None before the first estimate."""
        return min(self._estimates)[1] if self._estimates else None

    @property
    def uncertainty_ns(self) -> int | None:
        """Half width [ns] of the interval that contains the offset."""
        return min(self._estimates)[0] if self._estimates else None


BACKWARDS_NS = 100_000_000
"""Node-RED stamps one value twice, first with its own time, then with the message's: no fault."""


@dataclass(slots=True)
class _Stamp:
    stamp_ns: int
    value: object
    changes_without_advance: int = 0


@dataclass(frozen=True, slots=True)
class StampVerdict:
    """Result for one SourceTimestamp."""

    advanced: bool  # newer than the node's last one: it gives a latency
    fault: FaultKind | None = None  # FROZEN_STAMP or STAMP_BACKWARDS


class StampWatch:
    """Follows the SourceTimestamps of every node of a peer.

    A stamp counts as frozen once more than `tolerated_changes` values have changed under it.
    """

    def __init__(self, tolerated_changes: int = 2) -> None:
        self._tolerated = tolerated_changes
        self._nodes: dict[str, _Stamp] = {}

    def observe(self, node: str, stamp_ns: int | None, value: object) -> StampVerdict:
        """Judge the stamp [UTC ns] of one sample; the first one of a node is no evidence."""
        if stamp_ns is None:
            return StampVerdict(advanced=False)
        seen = self._nodes.get(node)
        if seen is None:
            self._nodes[node] = _Stamp(stamp_ns, value)
            return StampVerdict(advanced=False)
        changed = value != seen.value and not (value is None or seen.value is None)
        seen.value = value
        if stamp_ns > seen.stamp_ns:
            seen.stamp_ns = stamp_ns
            seen.changes_without_advance = 0
            return StampVerdict(advanced=True)
        if stamp_ns < seen.stamp_ns - BACKWARDS_NS:
            seen.stamp_ns = stamp_ns
            return StampVerdict(advanced=False, fault=FaultKind.STAMP_BACKWARDS)
        if stamp_ns == seen.stamp_ns:
            seen.changes_without_advance += changed
        frozen = seen.changes_without_advance > self._tolerated
        return StampVerdict(
            advanced=False, fault=FaultKind.FROZEN_STAMP if frozen else None
        )


def one_way_ns(stamp_ns: int, arrival_ns: int, offset_ns: int) -> int:
    """Return SourceTimestamp to arrival [ns], the peer's stamp converted to our clock."""
    return arrival_ns - (stamp_ns - offset_ns)
