"""``python -m benchmarks.page_clients URL N``: headless clients of the page, on command.

One word per line on standard input, one line of JSON as the answer: ``connect``, ``disconnect``,
``count`` (frames of each so far), ``stop`` and ``go`` (the first client stops or resumes reading).
"""

import asyncio
import json
import os
import re
import sys

import aiohttp

_SHOWN = ("pose.", "velocity.", "wheel.", "tof.", "lights.", "sim.", "battery.")
"""Prefixes of the names that the Drive view shows."""
_NICENESS = 5
_SIGNALS = 60


class _Browser:
    """One client with a cookie, a token and, while connected, a socket."""

    def __init__(self, url: str) -> None:
        self._url, self._origin = url, url.rstrip("/")
        self._session = aiohttp.ClientSession(cookie_jar=aiohttp.CookieJar(unsafe=True))
        self._token = ""
        self._socket: aiohttp.ClientWebSocketResponse | None = None
        self._reading: asyncio.Task[None] | None = None
        self.frames = 0

    async def connect(self) -> None:
        if not self._token:
            async with self._session.get(self._url) as answer:
                found = re.search(
                    r'name="token" content="([^"]+)"', await answer.text()
                )
            self._token = found[1] if found else ""
        headers = {"X-Hilserver-Token": self._token, "Origin": self._origin}
        async with self._session.post(
            f"{self._url}api/call", json={"method": "ticket"}, headers=headers
        ) as answer:
            ticket = (await answer.json())["result"]
        async with self._session.get(f"{self._url}api/signals") as answer:
            names = [s["name"] for s in (await answer.json())["signals"]]
        shown = [name for name in names if name.startswith(_SHOWN)][:_SIGNALS]
        socket = await self._session.ws_connect(
            f"{self._url}api/live", headers={"Origin": self._origin}, max_msg_size=0
        )
        await socket.send_json({"ticket": ticket})
        await socket.send_json({"subscribe": shown, "number": 1})
        self._socket = socket
        self._reading = asyncio.create_task(self._read(socket))

    async def _read(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        async for message in socket:
            self.frames += message.type is aiohttp.WSMsgType.BINARY

    async def disconnect(self) -> None:
        if self._socket is not None and self._reading is not None:
            await self._socket.close()
            await self._reading
            self._socket = None

    def pause(self, *, paused: bool) -> None:
        if (transport := self._transport) is not None:
            (transport.pause_reading if paused else transport.resume_reading)()

    @property
    def _transport(self) -> asyncio.ReadTransport | None:
        response = None if self._socket is None else self._socket._response
        connection = None if response is None else response.connection
        found = None if connection is None else connection.transport
        return found if isinstance(found, asyncio.ReadTransport) else None

    async def close(self) -> None:
        await self.disconnect()
        await self._session.close()


async def _main(url: str, n: int) -> None:
    browsers = [_Browser(url) for _ in range(n)]
    try:
        while word := (await asyncio.to_thread(sys.stdin.readline)).strip():
            if word in ("connect", "disconnect"):
                await asyncio.gather(
                    *(getattr(browser, word)() for browser in browsers)
                )
            elif word in ("stop", "go"):
                browsers[0].pause(paused=word == "stop")
            print(json.dumps([browser.frames for browser in browsers]), flush=True)
    finally:
        for browser in browsers:
            await browser.close()


if __name__ == "__main__":
    os.nice(_NICENESS)
    asyncio.run(_main(sys.argv[1], int(sys.argv[2])))
