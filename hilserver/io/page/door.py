"""Places for connections: however many are held, a new one that requests something gets in.

=================  =================================================================================
no whole request   ends after `HEAD_S`, between two requests after `IDLE_S`; yields at once when all
                   places are taken
request at work    yields after `YIELDS_AFTER_S`
live socket        stays: their number is limited elsewhere
=================  =================================================================================

Among those that may yield, the address with the most connections loses the one that has waited
longest. So no one is kept out by others, and Stop finds a place.
"""

import asyncio
import socket
import ssl
import time
from collections import Counter
from collections.abc import Callable
from enum import IntEnum
from functools import partial
from typing import Any

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

from hilserver.tasks import SupervisedTask, Supervisor

MOST = 256
HEAD_S = 5.0
IDLE_S = 20.0
YIELDS_AFTER_S = 5.0
ACCEPT_AGAIN_S = 0.05


class Use(IntEnum):
    """What a connection is used for, in the order in which they yield."""

    WAITS = 0
    WORKS = 1
    LIVE = 2


class DoorPlace(asyncio.Protocol):
    """One connection, from before its TLS handshake; forwards to the protocol behind."""

    def __init__(self, door: "PageDoor", behind: Any, address: str) -> None:
        self.behind, self.address = behind, address
        self.handshake: SupervisedTask | None = None
        self._door, self._is_over = door, False
        self._transport: Any = None
        self._timer: asyncio.TimerHandle | None = None
        for name in (
            "data_received",
            "eof_received",
            "pause_writing",
            "resume_writing",
        ):
            setattr(self, name, getattr(behind, name))
        self.uses(Use.WAITS, HEAD_S)

    def connection_made(self, transport: Any) -> None:
        """Start the protocol behind, unless the place has been given back meanwhile."""
        if self._is_over:
            transport.abort()
        else:
            self._transport = transport
            self.behind.connection_made(transport)

    def uses(self, use: Use, limit_s: float | None = None) -> None:
        """Note what it is used for from now on, and how long at most."""
        self.use, self.since_s = use, time.monotonic()
        if self._timer is not None:
            self._timer.cancel()
        loop = asyncio.get_running_loop()
        self._timer = None
        if limit_s is not None and not self._is_over:
            self._timer = loop.call_later(limit_s, self._out_of_time)

    def _out_of_time(self) -> None:
        if self._transport is not None and self._transport.get_write_buffer_size():
            self.uses(Use.WAITS, IDLE_S)  # a large file over a slow line
        else:
            self.end()

    def end(self) -> None:
        """Give the place back."""
        self._is_over = True
        self._door.leave(self)
        if self._timer is not None:
            self._timer.cancel()
        if self._transport is not None:
            self._transport.abort()
        elif self.handshake is not None:
            self.handshake.cancel()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forward the loss and give the place back."""
        if self._transport is not None:
            self.behind.connection_lost(exc)
        self.end()


class PageDoor:
    """Accepts connections, and gives each a place before it has sent anything.

    `behind` makes the protocol that serves one connection.
    """

    def __init__(
        self,
        tls: ssl.SSLContext | None = None,
        most: int = MOST,
        tasks: Supervisor | None = None,
    ) -> None:
        self._tasks = Supervisor() if tasks is None else tasks
        self.tls = tls
        self.behind: Callable[[], Any] = asyncio.Protocol
        self._most = most
        self._places: dict[Any, DoorPlace] = {}

    async def let_in(self, listener: socket.socket) -> None:
        """Accept connections until cancelled."""
        listener.setblocking(False)
        loop = asyncio.get_running_loop()
        while True:
            try:
                connection, address = await loop.sock_accept(listener)
            except OSError:  # too many open files for now
                await asyncio.sleep(ACCEPT_AGAIN_S)
                continue
            place = self.place(address[0])
            if place is None:
                connection.close()
            else:
                greeting = partial(self._connect, place, connection)
                place.handshake = self._tasks.spawn(greeting, "page handshake")

    async def _connect(self, place: DoorPlace, connection: socket.socket) -> None:
        limit_s = None if self.tls is None else HEAD_S
        try:
            await asyncio.get_running_loop().connect_accepted_socket(
                lambda: place, connection, ssl=self.tls, ssl_handshake_timeout=limit_s
            )
        except (
            OSError,
            TimeoutError,
            RuntimeError,
        ):  # it is gone, or does not speak TLS
            place.end()

    def place(self, address: str) -> DoorPlace | None:
        """Return a place for a newcomer; if all are taken another yields, if none may: None."""
        if len(self._places) >= self._most:
            first = self._first_to_yield()
            if first is None:
                return None
            first.end()
        place = DoorPlace(self, self.behind(), address)
        self._places[place.behind] = place
        return place

    def _first_to_yield(self) -> DoorPlace | None:
        crowd = Counter(place.address for place in self._places.values())
        late_s = time.monotonic() - YIELDS_AFTER_S
        may_yield = (
            place
            for place in self._places.values()
            if place.use == Use.WAITS
            or (place.use == Use.WORKS and place.since_s < late_s)
        )
        return min(
            may_yield, key=lambda p: (p.use, -crowd[p.address], p.since_s), default=None
        )

    def leave(self, place: DoorPlace) -> None:
        """Free a place."""
        self._places.pop(place.behind, None)

    def stays(self, request: web.Request) -> None:
        """Keep the connection of a request from yielding: it is a live socket now."""
        if (place := self._places.get(request.protocol)) is not None:
            place.uses(Use.LIVE)

    def middleware(self) -> Middleware:
        """Return the middleware of the application, which notes requests at work."""

        @web.middleware
        async def note(request: web.Request, handler: Handler) -> web.StreamResponse:
            place = self._places.get(request.protocol)
            if place is None:
                return await handler(request)
            place.uses(Use.WORKS)
            try:
                return await handler(request)
            finally:
                place.uses(Use.WAITS, IDLE_S)

        return note
