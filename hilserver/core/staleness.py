"""When a peer's inputs are too old to drive by: a pure state machine on integer nanoseconds.

A peer is stale while nothing new came for longer than the limit, or while one input has been
unusable (NaN, text, bad status, missing) for longer than the limit: a robot must not go on with
three of its four set-points. A peer becomes fresh when something arrives while every commanding
input has a value; until then it is waited for, not lost, so that the two sides can be started in
any order and nodes may appear after their server.

This only reports: a peer's command lapses in the step, whatever happens to Python.
"""

from collections.abc import Collection
from enum import Enum


class Transition(Enum):
    """A change that the rest of the program must know about."""

    FIRST = "first"
    LOST = "lost"
    RESTORED = "restored"


class Staleness:
    """Judges the age of one peer's inputs.

    Parameters
    ----------
    limit_ns : int
        Age [ns] above which inputs are stale.
    commanding : collection of str
        Inputs without which the peer cannot command; the others may be missing.
    """

    def __init__(self, limit_ns: int, commanding: Collection[str] = ()) -> None:
        self.limit_ns = limit_ns
        self.stale = True
        self.reason = "never heard"
        self._commanding = frozenset(commanding)
        self._known = False
        self._checked_ns: int | None = None
        self._received_ns: int | None = None
        self._unusable_since_ns: dict[str, int] = {}

    @property
    def lacks_input(self) -> bool:
        """Whether a commanding input has no usable value now."""
        return bool(self.lacking)

    @property
    def lacking(self) -> frozenset[str]:
        """Commanding inputs that have no usable value now."""
        return self._commanding.intersection(self._unusable_since_ns)

    @property
    def waiting(self) -> bool:
        """Whether a stale peer still lacks a commanding input, so that it may not drive."""
        return self.stale and self.lacks_input

    def renew(self, now_ns: int) -> None:
        """Note that something new arrived: a higher counter, or a value if there is no counter."""
        self._received_ns = now_ns

    def unusable(self, name: str, now_ns: int) -> None:
        """Note that the newest sample of the input `name` cannot be used."""
        self._unusable_since_ns.setdefault(name, now_ns)

    def usable(self, name: str) -> None:
        """Note that the newest sample of the input `name` is good."""
        self._unusable_since_ns.pop(name, None)

    def check(self, now_ns: int) -> Transition | None:
        """Return what changed since the last check; `stale` and `reason` are then up to date."""
        reason = self._why_stale(now_ns)
        since_ns = 0 if self._checked_ns is None else now_ns - self._checked_ns
        self._checked_ns = now_ns
        if reason and not self.stale and since_ns > self.limit_ns:
            reason = f"the daemon's event loop was blocked for {since_ns / 1e6:.0f} ms"
        was_stale = self.stale
        self.stale = bool(reason)
        if reason:
            self.reason = reason
        if self.stale == was_stale:
            return None
        if self.stale:
            return Transition.LOST
        first = not self._known
        self._known = True
        return Transition.FIRST if first else Transition.RESTORED

    def _why_stale(self, now_ns: int) -> str:
        if self._received_ns is None:
            return "never heard"
        if now_ns - self._received_ns > self.limit_ns:
            return f"no new value for more than {self.limit_ns / 1e6:g} ms"
        if self.waiting:
            return f"{min(self.lacking)} has no usable value yet"
        for name, since_ns in self._unusable_since_ns.items():
            if now_ns - since_ns > self.limit_ns:
                return f"{name} has had no usable value for more than {self.limit_ns / 1e6:g} ms"
        return ""
