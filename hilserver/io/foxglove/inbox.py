"""What viewers publish: the newest value of each name, until the daemon takes it."""

import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, Final

import structlog
from foxglove.websocket import ServerListener

MOST_CHANNELS: Final = 1000
COMPLAIN_EVERY_S: Final = 1.0

_log = structlog.get_logger(__name__)


class Inbox(ServerListener):
    """Called in threads of the SDK; holds at most one value per signal.

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
        self._understand, self._knows, self._wake = understand, knows, wake
        self._channels: dict[tuple[int, int], tuple[str, str]] = {}
        self._lock = threading.Lock()
        self._newest: dict[str, object] = {}
        self._came_ns = 0
        self._complained_s = 0.0

    def take(self) -> tuple[Mapping[str, object], int]:
        """Return the values since the last call, and when the last one came (CLOCK_MONOTONIC)."""
        with self._lock:
            newest, self._newest = self._newest, {}
        return newest, self._came_ns

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
        written = {name: value for name, value in values.items() if self._knows(name)}
        if len(written) < len(values):
            unknown = next(name for name in values if name not in written)
            self._complain(known[0], f"there is no signal '{unknown:.60}' to write")
        if written:
            self._keep(written)

    def _keep(self, written: Mapping[str, object]) -> None:
        with self._lock:
            is_first = not self._newest
            self._newest |= written
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
