"""The door before the SDK's server: which web pages may enter, and how much each may send.

The SDK does not check the Origin and has no limit of rate. It therefore listens at a random
loopback address, which no web page can find; what comes to our address is checked here and
handed on. The SDK knows one name of its protocol; here older viewers are served by the earlier
name, as the messages are the same. A viewer that asks for nothing, as a subscription, is the first
to yield its place.
"""

import asyncio
import random
import re
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

import structlog

from hilserver.io.places import KeptPlace, PlaceKeeper
from hilserver.program import event_loop
from hilserver.program.event_loop import stop_listening
from hilserver.tasks import SupervisedTask, Supervisor, first_of
from hilserver.time_limit import time_limit

CONNECTIONS: Final = 32
HEAD_BYTES: Final = 8192
HEAD_S: Final = 5.0
PIECE_BYTES: Final = 16_384
BYTES_PER_S: Final = 262_144
LARGEST_MESSAGE: Final = 65_536
UNREAD_S: Final = 15.0
_REFUSED: Final = (
    b"HTTP/1.1 403 Forbidden\r\nConnection: close\r\nContent-Type: text/plain\r\n\r\n"
    b"this web page is not named in foxglove.origins\n"
)
SDK_PROTOCOL: Final = b"foxglove.sdk.v1"
EARLIER_PROTOCOL: Final = b"foxglove.websocket.v1"
_UNKNOWN: Final = (
    b"HTTP/1.1 400 Bad Request\r\nConnection: close\r\nContent-Type: text/plain\r\n\r\n"
    b"this is a WebSocket of Foxglove: ask for its subprotocol "
    + SDK_PROTOCOL
    + b" or "
    + EARLIER_PROTOCOL
    + b"\n"
)
_PROTOCOLS: Final = re.compile(rb"(?im)^(sec-websocket-protocol:)([^\r\n]*)")
_CONTINUED, _CONTROL = 0x0, 0x8

_log = structlog.get_logger(__name__)


def hidden_host() -> str:
    """Return a loopback address that cannot be guessed."""
    numbers = ["127", *(str(random.SystemRandom().randint(1, 254)) for _ in range(3))]
    return ".".join(numbers)


class ViewerDoor:
    """Listens for viewers and connects those that may enter with the server behind it."""

    def __init__(self, origins: Sequence[str], tasks: Supervisor | None = None) -> None:
        self._tasks = Supervisor() if tasks is None else tasks
        self._origins = frozenset(origin.rstrip("/").lower() for origin in origins)
        self._server: asyncio.Server | None = None
        self._behind = ("", 0)
        self._open: set[SupervisedTask] = set()
        self._places = PlaceKeeper(CONNECTIONS)

    @property
    def port(self) -> int:
        """The port that it listens on."""
        if self._server:
            return int(self._server.sockets[0].getsockname()[1])
        return 0

    async def open(self, host: str, port: int, behind: tuple[str, int]) -> None:
        """Listen; OSError if that is not possible."""
        self._behind = behind
        self._server = await asyncio.start_server(
            self._enter, host, port, limit=HEAD_BYTES
        )

    async def close(self) -> None:
        """Accept no more viewers, and end all connections."""
        if self._server is not None:
            await stop_listening(self._server)
        for job in tuple(self._open):
            await job.end()

    def _enter(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        # none once it has left
        address, *_ = writer.get_extra_info("peername") or ("unknown",)
        place = self._places.take(address, writer.transport.abort)
        if place is None:
            writer.transport.abort()
            return
        serving = partial(self._guarded, reader, writer, place)
        job = self._tasks.spawn(serving, "foxglove viewer")
        self._open.add(job)

        def ended() -> None:
            self._open.discard(job)
            self._places.leave(place)

        job.on_end = ended

    async def _guarded(
        self,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        place: KeptPlace,
    ) -> None:
        try:
            await self._serve(reader, writer, place)
        except (OSError, EOFError, ValueError, TimeoutError, asyncio.LimitOverrunError):
            pass  # it has left, or is not a viewer
        finally:
            writer.transport.abort()

    async def _serve(
        self,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        place: KeptPlace,
    ) -> None:
        async with time_limit(HEAD_S):
            head = await reader.readuntil(b"\r\n\r\n")
        named = []
        for line in head.split(b"\r\n")[1:]:
            name, _, value = line.partition(b":")
            if name.strip().lower() == b"origin":
                named.append(value.strip().decode("latin-1").rstrip("/").lower())
        may_enter = all(origin in self._origins for origin in named)
        refusal = b"" if may_enter else _REFUSED
        # RFC 6455, 4.1: names separated by commas, in one header or several
        lists = b",".join(values for _, values in _PROTOCOLS.findall(head))
        protocols = set(re.findall(rb"[^\s,]+", lists))
        if not refusal and not protocols & {SDK_PROTOCOL, EARLIER_PROTOCOL}:
            refusal = _UNKNOWN
            asked_for = b", ".join(sorted(protocols)).decode("latin-1")[:200] or "none"
            _log.warning(
                "foxglove viewer refused: it speaks another version",
                address=place.address,
                asks_for=asked_for,
                known=f"{SDK_PROTOCOL.decode()}, {EARLIER_PROTOCOL.decode()}",
            )
        if refusal:
            writer.write(refusal)
            await writer.drain()
            return
        speaks = SDK_PROTOCOL if SDK_PROTOCOL in protocols else EARLIER_PROTOCOL
        inner, outer = await asyncio.open_connection(*self._behind, limit=PIECE_BYTES)
        try:
            outer.write(_naming(head, SDK_PROTOCOL))
            async with time_limit(HEAD_S):
                answer = await inner.readuntil(b"\r\n\r\n")
            writer.write(_naming(answer, speaks))
            asks = partial(self._places.progress, place)
            await first_of(
                _sent(reader, outer, asks), _shown(inner, writer, place.address)
            )
        finally:
            outer.transport.abort()


def _naming(head: bytes, protocol: bytes) -> bytes:
    """Return the head of a request or an answer with this subprotocol alone."""
    return _PROTOCOLS.sub(rb"\1 " + protocol, head)


async def _shown(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, address: str
) -> None:
    """Forward data to the viewer, as long as it takes them; the SDK drops frames meanwhile."""
    event_loop.hold_little(writer.transport)
    while data := await reader.read(PIECE_BYTES):
        writer.write(data)
        try:
            async with time_limit(UNREAD_S):
                await writer.drain()
        except TimeoutError:
            _log.warning(
                "foxglove viewer does not take what it is shown: closed",
                address=address,
            )
            return


async def _sent(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, asks: Callable[[], None]
) -> None:
    """Forward data of the viewer, no faster than its share, without messages that are too long."""
    is_allowed = _short_messages()
    loop = asyncio.get_running_loop()
    free_s = loop.time()
    while data := await reader.read(PIECE_BYTES):
        if not is_allowed(data):
            return
        asks()
        writer.write(data)
        await writer.drain()
        free_s = max(free_s, loop.time() - 1.0) + len(data) / BYTES_PER_S
        if (early_s := free_s - loop.time()) > 0.0:
            await asyncio.sleep(early_s)


def _short_messages() -> Callable[[bytes], bool]:
    """Return a function that follows the frames of a WebSocket (RFC 6455, 5.2) piece by piece.

    It returns False once a message exceeds `LARGEST_MESSAGE`.
    """
    head = bytearray()
    left = 0
    message = 0

    def is_allowed(data: bytes) -> bool:
        nonlocal left, message
        at = 0
        while at < len(data):
            if left:
                step = min(left, len(data) - at)
                left -= step
                at += step
                continue
            head.append(data[at])
            at += 1
            if len(head) < 2 or len(head) < (size := _head_bytes(head[1])):
                continue
            digits = bytes(head[2 : size - (4 if head[1] & 0x80 else 0)])
            left = int.from_bytes(digits, "big") if digits else head[1] & 0x7F
            code = head[0] & 0x0F
            if code < _CONTROL:
                message = left + (message if code == _CONTINUED else 0)
            head.clear()
            if max(left, message) > LARGEST_MESSAGE:
                return False
        return True

    return is_allowed


def _head_bytes(second: int) -> int:
    extended = {126: 2, 127: 8}.get(second & 0x7F, 0)
    return 2 + extended + (4 if second & 0x80 else 0)
