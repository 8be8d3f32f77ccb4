"""What is wrong with a peer: reported when it begins and ends, kept while it lasts."""

from collections.abc import Callable
from enum import StrEnum

import structlog

from hilserver.core.events import Event, EventKind
from hilserver.io.link_status import PeerStatus

HOLD_NS = 5_000_000_000  # a fault that was not seen again for so long has ended

FAULTS_MAX = 64  # more different faults than this are counted but not listed

_log = structlog.get_logger(__name__)


class FaultBook:
    """Keeps `PeerStatus.faults`; a fault that flickers is one fault."""

    def __init__(self, status: PeerStatus, publish: Callable[[Event], None]) -> None:
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
        self._publish(Event(EventKind.PEER_FAULT, 500, self._status.name, message, now_ns))

    def refuse(self, kind: StrEnum, subject: str, sentence: str, now_ns: int) -> None:
        """Note why there is no session; lasts until `admit` or another reason, however long."""
        key = f"{kind}:{subject}"
        if key != self._refusal:
            self.admit()
        self.report(kind, subject, sentence, now_ns)
        self._refusal = key if key in self._seen_ns else None

    def admit(self) -> None:
        """End the reason why there was no session."""
        if self._refusal is not None:
            self._end(self._refusal)
        self._refusal = None

    def expire(self, now_ns: int) -> None:
        """End the faults that have not been seen for `HOLD_NS`."""
        for key in [k for k, seen_ns in self._seen_ns.items() if now_ns - seen_ns > HOLD_NS]:
            if key != self._refusal:
                self._end(key)

    def _end(self, key: str) -> None:
        del self._seen_ns[key]
        sentence = self._status.faults.pop(key)
        _log.info("peer fault ended", peer=self._status.name, what=sentence)
