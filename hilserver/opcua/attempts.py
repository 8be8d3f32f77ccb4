"""Failed log-ins: after a few of them an address or a name has to wait."""

from collections import OrderedDict, deque
from collections.abc import Hashable

from hilserver.opcua.loopback import is_loopback

_MOST_KEYS = 1000
WINDOW_S = 60.0


def keys_of(name: str, address: str) -> tuple[Hashable, ...]:
    """Return what a log-in counts for: its user name and the address it comes from.

    This computer's own address does not count, nor does none: several users share it.
    """
    keys = (("name", name[:64]), ("address", address))
    return keys[:1] if not address or is_loopback(address) else keys


class FailedAttempts:
    """Counts failures per key in a sliding window.

    The keys are bounded: the one that has been quiet longest is forgotten first.
    """

    def __init__(self, limit: int, window_s: float) -> None:
        self._limit = limit
        self._window_s = window_s
        self._failures: OrderedDict[Hashable, deque[float]] = OrderedDict()

    def is_blocked(self, key: Hashable, now_s: float) -> bool:
        """Whether `key` has to wait."""
        failures = self._failures.get(key)
        if failures is None:
            return False
        while failures and now_s - failures[0] >= self._window_s:
            failures.popleft()
        if not failures:
            del self._failures[key]
        return len(failures) >= self._limit

    def failed(self, key: Hashable, now_s: float) -> None:
        """Count one failure."""
        failures = self._failures.setdefault(key, deque(maxlen=self._limit))
        failures.append(now_s)
        self._failures.move_to_end(key)
        while len(self._failures) > _MOST_KEYS:
            self._failures.popitem(last=False)

    def withdraw(self, key: Hashable) -> None:
        """Take the newest failure of `key` back: nobody judged it."""
        if failures := self._failures.get(key):
            failures.pop()

    def succeeded(self, key: Hashable) -> None:
        """Forget the failures of `key`."""
        self._failures.pop(key, None)
