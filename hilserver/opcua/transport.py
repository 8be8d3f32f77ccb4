"""The socket side of a server: connections with deadlines.

A connection that makes no progress is closed: no Hello, no channel or an incomplete message after
`READ_DEADLINE_S`, no session after `LOGIN_DEADLINE_S`, unread answers after `UNREAD_DEADLINE_S`.
When all places are taken, the one that has waited longest without a session makes room.

On a busy computer an honest handshake takes seconds. So programs of our own user, as the operator
page, and whoever waits for us, have `BUSY_DEADLINE_S` for each stage.
"""

import asyncio
import contextlib
import time
from collections import Counter, deque
from collections.abc import Coroutine
from functools import partial
from typing import Any

from asyncua import ua
from asyncua.common.connection import TransportLimits
from asyncua.server.binary_server_asyncio import BinaryServer

from hilserver.opcua.frames import ConnectionStage, FrameReader, TransportError
from hilserver.opcua.login import release_session
from hilserver.opcua.logs import log
from hilserver.opcua.loopback import is_loopback, is_own_program
from hilserver.opcua.processor import Processor
from hilserver.opcua.rotation import Portions, advance
from hilserver.opcua.spawning import Running

READ_DEADLINE_S = 2.0
LOGIN_DEADLINE_S = 10.0
UNREAD_DEADLINE_S = 10.0
BUSY_DEADLINE_S = 60.0
_SWEEP_S = 0.2
_LONG_S, _LONG_REST_S = 0.002, 0.002
"""A request that has taken so long rests after each portion: it then gets a fifth of the loop."""
_MAX_UNREAD_BYTES = 256 * 1024
_MAX_QUEUED_BYTES = 256 * 1024
_Codes = ua.StatusCodes


class Connection(asyncio.Protocol):
    """A connection; as a job it processes one frame after the other, in portions."""

    def __init__(self, server: "Listener") -> None:
        self._server = server
        self._rotation = server.iserver.subscription_service.rotation
        self._reader = FrameReader()
        self._frames: deque[tuple[bytes, bytes]] = deque()
        self._queued_bytes = 0
        self._is_reading = True
        self._stage = ConnectionStage.NEW
        self._stage_since_s = self._parts_since_s = self._unread_since_s = 0.0
        self._work: Portions | None = None
        self._waiting: Running | None = None
        self._refused = TransportError(_Codes.BadTcpMessageTypeInvalid, "")
        self.transport: Any = None
        self.processor: Processor
        self.used_s = self.began_s = self._closing_since_s = 0.0
        self.address = ""
        self._is_own: bool | None = None  # looked up once it is late

    def connection_made(self, transport: Any) -> None:
        """Start to serve a client, if there is room."""
        self.began_s = self._stage_since_s = time.monotonic()
        self.transport = transport
        self.processor = Processor(
            self._server.iserver, transport, self._server.policies
        )
        self.address = self.processor.address
        if not self._server.make_room(self.address):
            log.warning("opcua connection refused: too many are open")
            transport.abort()
            return
        transport.set_write_buffer_limits(high=_MAX_UNREAD_BYTES)
        self._server.clients.append(self)
        self._server.iserver.asyncio_transports.append(transport)

    def connection_lost(self, error: BaseException | None) -> None:  # noqa: ARG002
        """Release everything."""
        # A refused client is on neither list, an evicted one on one of them.
        with contextlib.suppress(ValueError):
            self._server.iserver.asyncio_transports.remove(self.transport)
            self._server.clients.remove(self)
        self._rotation.drop(self)
        self._frames.clear()
        if self._waiting is not None:
            self._waiting.cancel()
        self._work = None
        release_session(self.processor)

    def data_received(self, data: bytes) -> None:
        """Cut frames out of the stream and queue them."""
        if self.transport.is_closing():
            return
        try:
            for kind, frame in self._reader.feed(data, time.monotonic()):
                self._queued_bytes += len(frame)
                self._frames.append((kind, frame))
        except TransportError as error:
            self._refused = error
            self._frames.append((b"", b""))
        if self._queued_bytes > _MAX_QUEUED_BYTES and self._is_reading:
            self._is_reading = False
            self.transport.pause_reading()
        self._ask_for_turns()

    def _ask_for_turns(self) -> None:
        if self._frames and self._is_free and self._work is None:
            self._rotation.add(self)

    @property
    def _is_free(self) -> bool:
        return self._waiting is None and not self.processor.is_congested

    def turn(self) -> bool:
        """Do a portion of a frame; whether there is more to do."""
        if self._work is None:
            if not self._frames or not self._is_free or self.transport.is_closing():
                return False
            kind, frame = self._frames.popleft()
            if not kind:
                self.processor.refuse(self._refused.code, str(self._refused))
                return False
            self._queued_bytes -= len(frame)
            self.processor.spent_s = self.processor.waited_s = 0.0
            outcome = self.processor.process_frame(kind, frame)
            if isinstance(outcome, bool):
                self._go_on(outcome)
                return bool(self._frames) and self._is_free
            self._work = outcome
        return self._advance(None)

    def _advance(self, answer: Any) -> bool:
        assert self._work is not None
        began_s = (
            time.thread_time()
        )  # a stall of the computer is no work of the request
        try:
            wanted = advance(self._work, answer)
        except StopIteration as done:
            self._work = None
            self._go_on(done.value)
            return bool(self._frames) and self._is_free
        self.processor.spent_s += time.thread_time() - began_s
        if wanted is None and self.processor.spent_s < _LONG_S:
            return True
        if wanted is None:
            asyncio.get_running_loop().call_later(
                _LONG_REST_S, self._rotation.add, self
            )
            return False
        waits = partial(self._wait, wanted)
        self._waiting = self._server.iserver.spawn(waits, "opcua request")
        return False

    async def _wait(self, wanted: Coroutine[Any, Any, Any]) -> None:
        began_s = time.monotonic()
        try:
            answer = await wanted
        except Exception as error:  # noqa: BLE001 - whatever it is, the request is answered with it
            answer = error
        self._waiting = None
        self.processor.waited_s += time.monotonic() - began_s
        if self._work is not None and self._advance(answer):
            self._rotation.add(self)

    def _go_on(self, goes_on: bool) -> None:
        if not goes_on:
            self.transport.close()
            return
        now_s = time.monotonic()
        if self.processor.stage is not self._stage:
            self._stage = self.processor.stage
            self._stage_since_s = now_s
        if not self.processor.has_parts:
            self._parts_since_s = 0.0
        elif not self._parts_since_s:
            self._parts_since_s = now_s
        if not self._is_reading and self._queued_bytes <= _MAX_QUEUED_BYTES // 2:
            self._is_reading = True
            self.transport.resume_reading()

    def pause_writing(self) -> None:
        """Read no more requests of a client that does not read its answers."""
        self.processor.is_congested, self._unread_since_s = True, time.monotonic()

    def resume_writing(self) -> None:
        """Continue: the client has read its answers."""
        self.processor.is_congested = False
        self._unread_since_s = 0.0
        if self.processor.session is not None:
            self.processor.session.resume()
        self._ask_for_turns()

    @property
    def is_active(self) -> bool:
        """Whether a session is active on this connection, and it is not closing."""
        return (
            self.processor.stage is ConnectionStage.ACTIVE
            and not self.transport.is_closing()
        )

    def check_deadlines(self, now_s: float) -> None:
        """Close the connection if it keeps us waiting."""
        if self.transport.is_closing():
            # It ends when the client has read the rest, which also has a limit.
            self._closing_since_s = self._closing_since_s or now_s
            if now_s - self._closing_since_s > READ_DEADLINE_S:
                self.transport.abort()
            return
        if self._unread_since_s and now_s - self._unread_since_s > UNREAD_DEADLINE_S:
            log.warning(
                "opcua client does not read its answers: closed", address=self.address
            )
            self.transport.abort()
            return
        limit_s = READ_DEADLINE_S - 2 * _SWEEP_S
        since_s = [
            s
            for s in (self._reader.since_s, self._parts_since_s)
            if s and self._is_reading
        ]
        is_late = any(now_s - since > limit_s for since in since_s)
        if self.processor.stage is not ConnectionStage.ACTIVE:
            is_late = is_late or self._stays_too_long(now_s)
        if is_late:
            self.processor.refuse(_Codes.BadTimeout, "the rest did not come in time")

    def _stays_too_long(self, now_s: float) -> bool:
        """Whether it has been without a session for longer than its stage allows."""
        stayed_s = now_s - self._stage_since_s
        is_open = self.processor.stage is ConnectionStage.OPEN
        if stayed_s <= (
            LOGIN_DEADLINE_S if is_open else READ_DEADLINE_S - 2 * _SWEEP_S
        ):
            return False
        waits_for_us = (
            bool(self._frames) or self._work is not None or self._waiting is not None
        )
        return stayed_s > BUSY_DEADLINE_S or not (
            waits_for_us or self._is_of_our_user()
        )

    def _is_of_our_user(self) -> bool:
        if self._is_own is None:
            ends = [
                self.transport.get_extra_info(name) for name in ("peername", "sockname")
            ]
            is_here = is_loopback(self.address) and None not in ends
            self._is_own = is_here and is_own_program(*(end[:2] for end in ends))
        return self._is_own


class Listener(BinaryServer):  # type: ignore[misc]
    """The listening socket and its connections."""

    def __init__(self, iserver: Any, host: str, port: int) -> None:
        super().__init__(iserver, host, port, TransportLimits())
        self._sweeper: Running | None = None

    @property
    def policies(self) -> list[Any]:
        """The security policies on offer."""
        return self._policies  # type: ignore[no-any-return]

    def _make_protocol(self) -> Connection:
        return Connection(self)

    def make_room(self, address: str) -> bool:
        """Whether one more connection from `address` may come in.

        One address gets half of the places, this computer's own all of them. The oldest connection
        without a session, of the address with the most, makes room.
        """
        most = self.iserver.max_connections
        clients = self.clients
        if not is_loopback(address):
            own = [client for client in clients if client.address == address]
            if len(own) >= max(1, most // 2):
                most = 0
                clients = own
        if len(clients) < most:
            return True
        crowd = Counter(client.address for client in clients)
        waiting = (client for client in clients if not client.is_active)
        oldest = max(waiting, key=lambda client: crowd[client.address], default=None)
        if oldest is None:
            return False
        self.clients.remove(oldest)
        oldest.transport.abort()
        return True

    async def start(self) -> None:
        """Listen, and watch the deadlines."""
        await super().start()
        self._sweeper = self.iserver.spawn(self._sweep, "opcua deadlines", lasting=True)

    async def stop(self) -> None:
        """Close the socket and all connections."""
        if self._sweeper is not None:
            await self._sweeper.end()
        await super().stop()

    async def _sweep(self) -> None:
        while True:
            await asyncio.sleep(_SWEEP_S)
            now_s = time.monotonic()
            for client in tuple(self.clients):
                client.check_deadlines(now_s)
            self.iserver.end_idle_sessions(now_s)
