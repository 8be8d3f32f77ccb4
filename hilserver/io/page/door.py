"""Places for connections: however many are held, one more that asks for something comes in.

=================  =================================================================================
no whole request   ends after `HEAD_S`, between two requests after `IDLE_S`; yields at once when all
                   places are taken
request at work    yields after `YIELDS_AFTER_S`
live socket        stays: their number is limited elsewhere
=================  =================================================================================

Of those that may yield it is one of the address that holds the most, and of its connections the one
that waits longest. So nobody is kept out by others, and Stop finds a place.
"""

import asyncio
import ssl
import time
from collections import Counter
from collections.abc import Callable
from enum import IntEnum
from typing import Any

from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

MOST = 256
HEAD_S = 5.0
IDLE_S = 20.0
YIELDS_AFTER_S = 5.0


class Use(IntEnum):
    """What a connection is used for, the first to yield first."""

    WAITS = 0
    WORKS = 1
    LIVE = 2


class Place(asyncio.Protocol):
    """One connection; hands everything on to the protocol behind."""

    def __init__(self, door: "Door", behind: Any) -> None:
        self.behind = behind
        self.address = ""
        self.use, self.since_s = Use.WAITS, time.monotonic()
        self._door = door
        self._transport: Any = None
        self._early: list[bytes] | None = []
        self._timer: asyncio.TimerHandle | None = None
        self._securing: asyncio.Task[None] | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Come in if there is a place, and agree on encryption."""
        self._transport = transport
        self.address = (transport.get_extra_info("peername") or ("",))[0]
        if not self._door.enter(self):
            self.end()
        elif self._door.tls is None:
            self._begin(transport)
        else:
            self._transport.pause_reading()  # until the hello of TLS has its reader
            self._securing = asyncio.ensure_future(self._secure(self._door.tls))
        self.uses(Use.WAITS, HEAD_S)

    async def _secure(self, tls: ssl.SSLContext) -> None:
        loop = asyncio.get_running_loop()
        try:
            secured = await loop.start_tls(
                self._transport, self, tls, server_side=True, ssl_handshake_timeout=HEAD_S
            )
        except (OSError, TimeoutError):
            secured = None
        if secured is None:
            self.end()
        else:
            self._begin(secured)

    def _begin(self, transport: Any) -> None:
        early, self._early = self._early, None
        self._transport = transport
        self.behind.connection_made(transport)
        for data in early or ():
            self.behind.data_received(data)

    def uses(self, use: Use, limit_s: float | None = None) -> None:
        """Note what it is used for from now on, and how long at most."""
        self.use, self.since_s = use, time.monotonic()
        if self._timer is not None:
            self._timer.cancel()
        loop = asyncio.get_running_loop()
        self._timer = None if limit_s is None else loop.call_later(limit_s, self._out_of_time)

    def _out_of_time(self) -> None:
        if self._transport.get_write_buffer_size():  # a slow line takes a large file
            self.uses(Use.WAITS, IDLE_S)
        else:
            self.end()

    def end(self) -> None:
        """Give the place back."""
        self._door.leave(self)
        self._transport.abort()

    def data_received(self, data: bytes) -> None:
        """Hand on."""
        if self._early is None:
            self.behind.data_received(data)
        else:
            self._early.append(data)

    def eof_received(self) -> bool | None:
        """Hand on."""
        return self.behind.eof_received() if self._early is None else None

    def pause_writing(self) -> None:
        """Hand on."""
        self.behind.pause_writing()

    def resume_writing(self) -> None:
        """Hand on."""
        self.behind.resume_writing()

    def connection_lost(self, exc: Exception | None) -> None:
        """Hand on."""
        self._door.leave(self)
        if self._timer is not None:
            self._timer.cancel()
        if self._early is None:
            self.behind.connection_lost(exc)


class Door:
    """Makes a place of every connection; an `asyncio` protocol factory.

    Parameters
    ----------
    tls : SSLContext, optional
        What encrypts connections.

    Attributes
    ----------
    behind : callable
        Makes the protocol that serves one connection.
    """

    def __init__(self, tls: ssl.SSLContext | None = None, most: int = MOST) -> None:
        self.tls = tls
        self.behind: Callable[[], Any] = asyncio.Protocol
        self._most = most
        self._places: dict[Any, Place] = {}

    def __call__(self) -> Place:
        """Return the protocol of a new connection."""
        return Place(self, self.behind())

    def enter(self, newcomer: Place) -> bool:
        """Give it a place; another one yields if all are taken."""
        if len(self._places) >= self._most:
            first = self._first_to_yield()
            if first is None:
                return False
            first.end()
        self._places[newcomer.behind] = newcomer
        return True

    def _first_to_yield(self) -> Place | None:
        crowd = Counter(place.address for place in self._places.values())
        late_s = time.monotonic() - YIELDS_AFTER_S
        may_yield = (
            place
            for place in self._places.values()
            if place.use == Use.WAITS or (place.use == Use.WORKS and place.since_s < late_s)
        )
        return min(may_yield, key=lambda p: (p.use, -crowd[p.address], p.since_s), default=None)

    def leave(self, place: Place) -> None:
        """Take its place back."""
        self._places.pop(place.behind, None)

    def stays(self, request: web.Request) -> None:
        """Keep the connection of a request from yielding: it is a live socket now."""
        if (place := self._places.get(request.protocol)) is not None:
            place.uses(Use.LIVE)

    def middleware(self) -> Middleware:
        """Return the middleware of the application, which notes who works."""

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
