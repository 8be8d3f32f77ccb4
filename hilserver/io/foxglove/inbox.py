"""What viewers publish: the newest message of each set of names, until the daemon takes it."""

import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, Final

import structlog
from foxglove.websocket import ServerListener

MOST_CHANNELS: Final = 1000
MOST_SETS: Final = 32
COMPLAIN_EVERY_S: Final = 1.0

_log = structlog.get_logger(__name__)


class Inbox(ServerListener):
    """Called in threads of the SDK; holds one message per set of names, and at most 32.

    A message is a request: what is wrong with one says nothing of the others.

    Parameters
    ----------
    understand : callable
        ``understand(topic, encoding, data)`` returns values; ValueError if it is not a command.
    knows : callable
        Whether a signal of this name may be written.
    wake : callable
        Asks the daemon to `take`; called once until it does.
    """

    def __init__(
        self,
        understand: Callable[[str, str, bytes], Mapping[str, object]],
        knows: Callable[[str], bool],
        wake: Callable[[], None],
    ) -> None:
        self._understand = understand
        self._knows = knows
        self._wake = wake
        self._channels: dict[tuple[int, int], tuple[str, str]] = {}
        self._lock = threading.Lock()
        self._newest: dict[frozenset[str], Mapping[str, object]] = {}
        self._came_ns = 0
        self._complained_s = 0.0

    def take(self) -> tuple[list[Mapping[str, object]], int]:
        """Return messages since the last call, and when the last one came (CLOCK_MONOTONIC)."""
        with self._lock:
            newest = self._newest
            self._newest = {}
        return [*newest.values()], self._came_ns

    def on_client_advertise(self, client: Any, channel: Any) -> None:
        """Remember the topic of a client's channel."""
        self._channels[client.id, channel.id] = channel.topic, channel.encoding
        if len(self._channels) > MOST_CHANNELS:  # the end of a client is not announced
            del self._channels[next(iter(self._channels))]

    def on_client_unadvertise(self, client: Any, client_channel_id: int) -> None:
        """Forget the channel."""
        self._channels.pop((client.id, client_channel_id), None)

    def on_message_data(self, client: Any, client_channel_id: int, data: bytes) -> None:
        """Keep the newest values."""
        known = self._channels.get((client.id, client_channel_id))
        if known is None:
            return
        try:
            values = self._understand(*known, bytes(data))
        except ValueError as error:
            self._complain(known[0], f"{error!r:.100}")
            return
        unknown = next((name for name in values if not self._knows(name)), None)
        if unknown is not None:  # it may have been meant as a part of the same command
            self._complain(known[0], f"there is no signal '{unknown:.60}' to write")
        elif values:
            names = frozenset(values)
            with self._lock:
                is_first = not self._newest
                self._newest.pop(names, None)
                self._newest[names] = values  # the last one, as it came last
                if len(self._newest) > MOST_SETS:
                    del self._newest[next(iter(self._newest))]
                self._came_ns = time.monotonic_ns()
            if is_first:
                self._wake()

    def _complain(self, topic: str, why: str) -> None:
        now_s = time.monotonic()
        if now_s - self._complained_s >= COMPLAIN_EVERY_S:
            self._complained_s = now_s
            _log.warning(
                "a viewer published something that is not a command",
                topic=topic,
                why=why,
            )
