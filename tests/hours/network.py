"""TCP in memory: delays, pieces, full buffers, cuts, and ends that vanish without a word.

Each direction keeps its order; different connections overtake one another. What was written is
*in the kernel* of the receiver after its delay, and read once the receiver's loop turns.
"""

import asyncio
import itertools
import random
import socket
import sys
from collections import deque
from collections.abc import Callable
from typing import Any

from tests.hours.loop import NS, VirtualLoop

# both buffers of a direction, beyond which a writer is held up
KERNEL_BYTES = 32 * 1024
DELAY_NS = (50_000, 3_000_000)
CONNECT_NS = (100_000, 5_000_000)
SYN_S = 120.0
PIECE = 0.05  # share of reads that get only a piece


class Mark:
    """A place in a stream of bytes; when it came to the other computer, and was read there."""

    came_ns: int | None = None
    read_ns: int | None = None


class _Socket:
    """What programs ask of the kernel's socket."""

    def __init__(self, transport: "MemoryTransport") -> None:
        self._transport = transport

    def getsockname(self) -> tuple[str, int]:
        return self._transport.names[0]

    def setsockopt(self, *_: Any) -> None:
        """Options change nothing here."""

    def getsockopt(self, level: int, option: int, length: int = 0) -> Any:
        """Return how long ago the newest data came in; the rest of TCP_INFO is 0."""
        if (level, option) != (socket.IPPROTO_TCP, socket.TCP_INFO):
            return 0
        now_ns = self._transport.loop.clock.now_ns
        age_ms = max(now_ns - self._transport.came_ns, 0) // 1_000_000
        return bytes(52) + age_ms.to_bytes(4, sys.byteorder)


class MemoryTransport(asyncio.Transport):
    """One end of a connection."""

    def __init__(self, network: "Network", names: tuple[Any, Any]) -> None:
        super().__init__()
        self.network, self.loop, self.names = network, network.loop, names
        self.other: MemoryTransport
        self.protocol: Any = None
        self.label = ""  # who uses it
        self.came_ns = 0  # when the newest data that was read came in
        self.is_frozen = False  # its program stands still: it neither reads nor writes
        self.is_vanished = False  # its computer is gone: nobody is told
        self.reads_slowly_ns = 0
        self._socket = _Socket(self)
        # from here to the other end
        self._unsent: deque[tuple[int, bytes, Mark | None]] = deque()
        self._unsent_bytes = self._read_bytes = 0
        self._newest_ns = 0
        self._high = 64 * 1024
        self._is_reading, self._is_held_up = True, False
        self._is_closing = self._is_over = self._has_alarm = False

    # --- for the program --------------------------------------------------------------------------

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        own, theirs = self.names
        return {"socket": self._socket, "sockname": own, "peername": theirs}.get(
            name, default
        )

    def set_protocol(self, protocol: Any) -> None:
        self.protocol = protocol

    def get_protocol(self) -> Any:
        return self.protocol

    def is_closing(self) -> bool:
        return self._is_closing

    def set_write_buffer_limits(
        self, high: int | None = None, low: int | None = None
    ) -> None:
        self._high = 64 * 1024 if high is None else high

    def get_write_buffer_size(self) -> int:
        """Bytes beyond what the kernel takes."""
        return max(self._unsent_bytes - KERNEL_BYTES, 0)

    def can_write_eof(self) -> bool:
        return False

    def is_reading(self) -> bool:
        return self._is_reading

    def pause_reading(self) -> None:
        self._is_reading = False

    def resume_reading(self) -> None:
        self._is_reading = True
        self.other.set_alarm()

    def write(self, data: bytes) -> None:
        if self._is_closing or not data:
            return
        self._put(bytes(data), None)
        if not self._is_held_up and self.get_write_buffer_size() > self._high:
            self._is_held_up = True
            self.protocol.pause_writing()

    def close(self) -> None:
        """Let the rest arrive, then end."""
        if not self._is_closing:
            self._is_closing = True
            self._put(b"", None)
            if not self.get_write_buffer_size():
                # the kernel sends the rest
                self.loop.arrive(self.loop.clock.now_ns, self.end)

    def abort(self) -> None:
        self._is_closing = True
        self._unsent.clear()
        self._unsent_bytes = 0
        self.loop.arrive(self._soon_ns(), self.end)
        if not self.is_vanished:
            error = ConnectionResetError(104, "Connection reset by peer")
            self.loop.arrive(self._soon_ns(), lambda: self.other.end(error))

    # --- the wire ---------------------------------------------------------------------------------

    def mark(self) -> Mark:
        """Mark what has been written so far."""
        mark = Mark()
        self._put(b"", mark)
        return mark

    def _soon_ns(self) -> int:
        return self.loop.clock.now_ns + self.network.delay_ns()

    def _put(self, data: bytes, mark: Mark | None) -> None:
        if mark is None:
            lag_ns = self.network.lags_ns.get(self.names[0][1], 0)
            self._newest_ns = max(self._newest_ns, self._soon_ns() + lag_ns)
        self._unsent.append((self._newest_ns, data, mark))
        self._unsent_bytes += len(data)
        port = self.names[0][1]
        self.network.most_unsent[port] = max(
            self.network.most_unsent.get(port, 0), self.get_write_buffer_size()
        )
        self.set_alarm()

    def set_alarm(self) -> None:
        """Look at the wire when its oldest bytes are there."""
        if self._has_alarm or not self._unsent:
            return
        self._has_alarm = True
        at_ns = max(self._unsent[0][0], self.network.held_until_ns)
        self.loop.arrive(at_ns + self.other.reads_slowly_ns, self._deliver)

    def _deliver(self) -> None:
        self._has_alarm = False
        other, now_ns = self.other, self.loop.clock.now_ns
        if self.is_frozen or other.is_frozen or self.is_vanished or other.is_vanished:
            return  # thaw sets the alarm again
        if not other._is_reading and not other._is_over:
            return
        if self._unsent and now_ns < self.network.held_until_ns:
            self.set_alarm()
            return
        data, most = bytearray(), self.network.piece_bytes(other)
        while self._unsent and self._unsent[0][0] <= now_ns and len(data) < most:
            came_ns, piece, mark = self._unsent.popleft()
            if not piece and mark is None:  # the end
                self._pass_on(data)
                self.loop.arrive(now_ns, self.end)
                self.loop.arrive(self._soon_ns(), other.end)
                return
            if len(data) + len(piece) > most:
                cut = most - len(data)
                self._unsent.appendleft((came_ns, piece[cut:], mark))
                piece, mark = piece[:cut], None
            data += piece
            other.came_ns = came_ns
            if mark is not None:
                mark.came_ns, mark.read_ns = came_ns, now_ns
        self._pass_on(data)
        self.set_alarm()

    def _pass_on(self, data: bytearray) -> None:
        self._unsent_bytes -= len(data)
        other = self.other
        if data and not other._is_over and not other._is_closing:
            self.network.heard(other)
            other.protocol.data_received(bytes(data))
        if self._is_held_up and self.get_write_buffer_size() <= self._high // 4:
            self._is_held_up = False
            if not self._is_over:
                self.protocol.resume_writing()

    def end(self, error: Exception | None = None) -> None:
        """Tell the program that its connection is over; once."""
        if self._is_over or self.is_vanished:
            return
        if self.is_frozen:
            self.network.on_thaw(self, lambda: self.end(error))
            return
        self._is_over = self._is_closing = True
        self.network.forget(self)
        self.protocol.connection_lost(error)


class _Server:
    """What `create_server` returns."""

    def __init__(self, network: "Network", factory: Any, host: str, port: int) -> None:
        self.network, self.factory, self.name = network, factory, (host, port)
        self.sockets, self.label = [self], ""  # label of its ends

    def getsockname(self) -> tuple[str, int]:
        return self.name

    def is_serving(self) -> bool:
        return self.network.listening.get(self.name[1]) is self

    async def start_serving(self) -> None:
        """It does already."""

    def close(self) -> None:
        if self.is_serving():
            del self.network.listening[self.name[1]]

    async def wait_closed(self) -> None:
        await asyncio.sleep(0)

    async def __aenter__(self) -> "_Server":
        return self

    async def __aexit__(self, *_: object) -> None:
        self.close()


class Network:
    """All connections of a world."""

    def __init__(self, loop: VirtualLoop) -> None:
        self.loop, loop.network = loop, self
        self.listening: dict[int, _Server] = {}
        self.open: dict[MemoryTransport, None] = {}
        self.held_until_ns = 0  # nothing arrives before, anywhere
        # how much later what a server at a port says arrives
        self.lags_ns: dict[int, int] = {}
        self.swallows: set[int] = set()  # ports whose computer does not answer
        # bytes that a server kept for a client, by port
        self.most_unsent: dict[int, int] = {}
        self.heard: Callable[[MemoryTransport], None] = lambda _at: None
        self._ports = itertools.count(40_000)
        self._thawing: dict[MemoryTransport, list[Callable[[], None]]] = {}

    @property
    def chance(self) -> random.Random:
        return self.loop.chance

    def delay_ns(self) -> int:
        return self.chance.randint(*DELAY_NS)

    def piece_bytes(self, reader: MemoryTransport) -> int:
        """Return how much is read at once."""
        if reader.reads_slowly_ns:
            return 512
        return self.chance.randint(1, 200) if self.chance.random() < PIECE else 1 << 18

    def listen(self, factory: Any, host: str, port: int) -> _Server:
        port = port or next(self._ports)
        if port in self.listening:
            raise OSError(98, "Address already in use")
        self.listening[port] = server = _Server(
            self, factory, host or "127.0.0.1", port
        )
        return server

    async def connect(self, factory: Any, host: str, port: int) -> tuple[Any, Any]:
        await asyncio.sleep(self.chance.randint(*CONNECT_NS) / NS)
        if port in self.swallows:
            await asyncio.sleep(SYN_S)
        server = self.listening.get(port)
        if server is None:
            raise ConnectionRefusedError(111, "Connection refused")
        own, theirs = ("127.0.0.1", next(self._ports)), (host, port)
        here, there = (
            MemoryTransport(self, (own, theirs)),
            MemoryTransport(self, (theirs, own)),
        )
        here.other, there.other = there, here
        for transport, make in ((here, factory), (there, server.factory)):
            transport.protocol = make()
            self.open[transport] = None
        there.label = server.label
        self.loop.call_soon(there.protocol.connection_made, there)
        here.protocol.connection_made(here)
        return here, here.protocol

    def forget(self, transport: MemoryTransport) -> None:
        self.open.pop(transport, None)

    # --- faults -----------------------------------------------------------------------------------

    def cut(self, transport: MemoryTransport) -> None:
        """Break a connection; both ends are told, each at its own time."""
        transport.abort()
        error = ConnectionResetError(104, "Connection reset by peer")
        self.loop.arrive(
            self.loop.clock.now_ns + self.delay_ns(), lambda: transport.end(error)
        )

    def vanish(self, transport: MemoryTransport) -> None:
        """Let one end and its computer be gone: the other end is not told."""
        transport.is_vanished = True

    def freeze(self, transport: MemoryTransport) -> None:
        """Let the program at this end stand still; its connection stays open."""
        transport.is_frozen = True

    def thaw(self, transport: MemoryTransport) -> None:
        """Let it go on: what waited arrives now."""
        transport.is_frozen = False
        for what in self._thawing.pop(transport, ()):
            self.loop.call_soon(what)
        transport.set_alarm()
        transport.other.set_alarm()

    def on_thaw(self, transport: MemoryTransport, what: Callable[[], None]) -> None:
        self._thawing.setdefault(transport, []).append(what)

    def hold(self, seconds: float) -> None:
        """Let nothing arrive for a while, as while a switch learns."""
        self.held_until_ns = self.loop.clock.now_ns + round(seconds * NS)
