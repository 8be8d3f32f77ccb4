"""The sockets: frames of the process image many times a second, the board twice a second.

A browser that does not take its frames loses them; nothing waits for it.
"""

import asyncio
import json
import logging
import time
from collections.abc import Mapping
from functools import partial
from typing import Any

from aiohttp import WSCloseCode, WSMsgType, web

from hilserver.image import Frame, ImageReader
from hilserver.image.board import BoardReader
from hilserver.io.page.browsers import Browser
from hilserver.io.page.door import PageDoor
from hilserver.io.page.driving import PageDriving
from hilserver.io.page.frames import Selection, stamp_ms
from hilserver.io.page.hand import RefusedError
from hilserver.io.page.jobs import Jobs
from hilserver.io.page.stopping import Shown, Stopping
from hilserver.program import event_loop
from hilserver.tasks import Supervisor
from hilserver.time_limit import time_limit

MESSAGE_BYTES = 65_536
MESSAGES_PER_S = 200
MAX_SIGNALS = 500
UNREAD_BYTES = 32_768
WRITABLE_BYTES = UNREAD_BYTES + (1 << 20)
"""More than is ever sent at once (a full board) to a client that is ready: no send waits."""
UNREAD_S = 15.0
BOARD_EVERY_S = 0.5
GREET_S = 5.0
CONFIRM_S = 60.0

_log = logging.getLogger(__name__)


class Client:
    """One socket of one browser."""

    def __init__(
        self, number: int, browser: Browser, request: web.Request, tasks: Supervisor
    ) -> None:
        self.number, self.browser, self._tasks = number, browser, tasks
        self.selection: Selection | None = None
        self.lost = 0  # frames left out because it did not take earlier ones
        self.socket = web.WebSocketResponse(
            max_msg_size=MESSAGE_BYTES, compress=False, heartbeat=20.0
        )
        self._transport = request.transport
        event_loop.hold_little(self._transport)
        if self._transport is not None:
            self._transport.set_write_buffer_limits(WRITABLE_BYTES, UNREAD_BYTES)
        self._blocked_since_s: float | None = None

    @property
    def is_ready(self) -> bool:
        """Whether it has taken what was sent; one that takes nothing for long is dropped."""
        transport = self._transport
        if transport is None or self.socket.closed or transport.is_closing():
            return False
        if transport.get_write_buffer_size() <= UNREAD_BYTES:
            self._blocked_since_s = None
            return True
        self.lost += 1
        now_s = time.monotonic()
        self._blocked_since_s = self._blocked_since_s or now_s
        if now_s - self._blocked_since_s > UNREAD_S:
            _log.warning(
                "page: browser %s takes nothing any more: closed", self.browser.address
            )
            transport.abort()
        return False

    def tell(self, message: Mapping[str, Any]) -> None:
        """Send a message; never waits."""
        if self.is_ready:
            self.later(self.socket.send_str(json.dumps(message)))

    def later(self, sending: Any) -> None:
        """Send without waiting for it; cancelled by nothing but its own end."""
        self._tasks.spawn(partial(_ignoring_loss, sending), "message to a browser")


async def _ignoring_loss(sending: Any) -> None:
    try:
        await sending
    except (ConnectionError, RuntimeError):
        return


class Live:
    """All sockets, and the loop that serves them."""

    def __init__(
        self,
        reader: ImageReader,
        slots: Mapping[str, int],
        driving: PageDriving,
        *,
        rate_hz: float,
        max_clients: int,
        jobs: Jobs,
        stopping: Stopping,
        door: PageDoor,
        tasks: Supervisor | None = None,
    ) -> None:
        self._tasks = Supervisor() if tasks is None else tasks
        self._reader, self._slots, self._driving = reader, slots, driving
        self._board = BoardReader(reader)
        self._period_s, self._max_clients, self._jobs = 1.0 / rate_hz, max_clients, jobs
        self._stopping, self._door = stopping, door
        self._clients: dict[int, Client] = {}
        self._next = 1
        self.frames_sent = 0

    def find(self, number: object) -> Client | None:
        """Return a client by its number."""
        return self._clients.get(number) if isinstance(number, int) else None

    @property
    def board(self) -> dict[str, Any]:
        """The newest board of the daemon."""
        return self._board.content

    async def serve(
        self, request: web.Request, browser: Browser
    ) -> web.WebSocketResponse:
        """Serve one socket until it closes."""
        client = Client(self._next, browser, request, self._tasks)
        self._next += 1
        await client.socket.prepare(request)
        if (refusal := await self._refusal(client)) is not None:
            await _close(client, *refusal)
            return client.socket
        welcome = json.dumps({"type": "welcome", "you": client.number})
        # before any board or frame
        await _ignoring_loss(client.socket.send_str(welcome))
        self._clients[client.number] = client
        self._door.stays(request)
        browser.live += 1
        try:
            client.tell(self._slow())
            await self._listen(client)
        finally:
            browser.live -= 1
            del self._clients[client.number]
            self._driving.leave(client)
        return client.socket

    async def _refusal(self, client: Client) -> tuple[int, str] | None:
        """Return why a socket may not stay, None if it may; others may connect meanwhile."""
        full = (WSCloseCode.TRY_AGAIN_LATER, "too many browsers")
        if not self._has_place(client.browser):
            return full
        if not await self._greeted(client):
            return WSCloseCode.POLICY_VIOLATION, "no valid ticket"
        return None if self._has_place(client.browser) else full

    def _has_place(self, browser: Browser) -> bool:
        if browser.may_stop:
            return len(self._clients) < self._max_clients
        watchers = sum(not client.browser.may_stop for client in self._clients.values())
        free = self._max_clients - self._max_clients // 10
        return watchers < free and len(self._clients) < self._max_clients

    async def _greeted(self, client: Client) -> bool:
        try:
            async with time_limit(GREET_S):
                data = await client.socket.receive_json()
        except (TypeError, ValueError, TimeoutError):
            return False
        return isinstance(data, dict) and client.browser.take_ticket(data.get("ticket"))

    async def _listen(self, client: Client) -> None:
        second, count = 0, 0
        async for message in client.socket:
            now_s = int(time.monotonic())
            second, count = (second, count + 1) if now_s == second else (now_s, 1)
            if message.type is not WSMsgType.TEXT or count > MESSAGES_PER_S:
                await _close(
                    client, WSCloseCode.POLICY_VIOLATION, "not a message of this page"
                )
                return
            try:
                self._understand(client, json.loads(message.data))
            except RefusedError as error:
                client.tell({"type": "refused", "text": str(error)})
            except (ValueError, TypeError, KeyError, RecursionError):
                await _close(
                    client, WSCloseCode.POLICY_VIOLATION, "not a message of this page"
                )
                return

    def _understand(self, client: Client, data: Mapping[str, Any]) -> None:
        if "stop" in data:
            shown = self._stopping.press(client.browser)
            client.tell({"type": "pressed", "number": data["stop"]})
            client.later(self._confirm(client, data["stop"], shown))
        elif "drive" in data:
            self._driving.command(client, dict(data["drive"]))
        elif "subscribe" in data:
            names, number = data["subscribe"], data["number"]
            if len(names) > MAX_SIGNALS or not isinstance(number, int):
                raise ValueError("too many signals")
            client.selection = Selection(number, [self._slots[name] for name in names])
        else:
            raise ValueError("unknown message")

    async def _confirm(self, client: Client, number: object, shown: Shown) -> None:
        if await shown(CONFIRM_S):
            client.tell({"type": "stopped", "number": number})

    async def run(self) -> None:
        """Send frames and boards until cancelled."""
        loop = asyncio.get_running_loop()
        next_s, board_s, board = loop.time(), loop.time(), self.board
        while True:
            next_s = max(next_s + self._period_s, loop.time())
            await asyncio.sleep(next_s - loop.time())
            if not self._clients:
                continue
            frame = self._reader.latest()
            if frame is not None:
                await self._send(frame)
            if self.board is not board or loop.time() >= board_s:
                board, board_s = self.board, loop.time() + BOARD_EVERY_S
                text = json.dumps(self._slow(), separators=(",", ":"))
                await self._send_text(text)

    async def _send(self, frame: Frame) -> None:
        stamp, encoded = stamp_ms(), dict[Any, bytes]()
        for client in tuple(self._clients.values()):
            selection = client.selection
            if selection is None or not client.is_ready:
                continue
            data = encoded.get(selection.key)
            if data is None:
                data = encoded[selection.key] = selection.encode(frame, stamp)
            await _ignoring_loss(client.socket.send_bytes(data))
            self.frames_sent += 1

    async def _send_text(self, text: str) -> None:
        for client in tuple(self._clients.values()):
            if client.is_ready:
                await _ignoring_loss(client.socket.send_str(text))

    @property
    def driver(self) -> int | None:
        """Number of the socket that drives, if the page does."""
        seat = self._driving.driver
        is_there = seat is not None and self.find(seat.number) is not None
        drives = self.board.get("owner") == "page" or self._driving.is_new
        return seat.number if seat and is_there and drives else None

    def _slow(self) -> dict[str, Any]:
        board = self.board
        return {
            "type": "board",
            "board": board,
            "age_s": time.monotonic() - board.get("monotonic_s", 0.0),
            "driver": self.driver,
            "clients": len(self._clients),
            "jobs": self._jobs.view(),
        }

    async def close(self) -> None:
        """Close all sockets."""
        for client in tuple(self._clients.values()):
            await _close(client, WSCloseCode.GOING_AWAY, "the daemon has ended")


async def _close(client: Client, code: int, why: str) -> None:
    try:
        async with time_limit(1.0):
            await client.socket.close(code=code, message=why.encode())
    except (TimeoutError, ConnectionError, RuntimeError):
        return
