"""A real browser for the benches, over the Chrome DevTools Protocol."""

import asyncio
import contextlib
import itertools
import json
import shutil
import tempfile
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, Self

import aiohttp

from hilserver.errors import FailedError
from hilserver.program.children import started

_ARGUMENTS = (
    "--headless",
    "--no-sandbox",
    "--disable-background-networking",
    "--mute-audio",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--window-size=1280,800",
    "--remote-debugging-port=0",
)
START_WITHIN_S, ANSWER_WITHIN_S = 60.0, 300.0


class Tab:
    """One tab of the browser."""

    def __init__(self, socket: aiohttp.ClientWebSocketResponse) -> None:
        self._socket, self._numbers = socket, itertools.count(1)
        self._answers: dict[int, asyncio.Future[dict[str, Any]]] = {}
        self._trace: list[dict[str, Any]] = []
        self._traced = asyncio.Event()
        self._reading = asyncio.create_task(self._read())

    @classmethod
    async def open(cls, session: aiohttp.ClientSession, port: int) -> Self:
        """Open an empty tab."""
        async with session.put(
            f"http://127.0.0.1:{port}/json/new?about:blank"
        ) as answer:
            address = (await answer.json())["webSocketDebuggerUrl"]
        return cls(await session.ws_connect(address, max_msg_size=0))

    async def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command of the protocol; return its result.

        Raises
        ------
        FailedError
            If the browser refuses it or does not answer.
        """
        number = next(self._numbers)
        answer = self._answers[number] = asyncio.get_running_loop().create_future()
        await self._socket.send_json(
            {"id": number, "method": method, "params": parameters}
        )
        try:
            async with asyncio.timeout(ANSWER_WITHIN_S):
                found = await answer
        except TimeoutError:
            raise FailedError(f"chromium does not answer to {method}") from None
        if "error" in found:
            raise FailedError(f"chromium: {method}: {found['error']['message']}")
        result: dict[str, Any] = found["result"]
        return result

    async def run(self, script: str) -> Any:
        """Run a script in the page, wait for its promise, return its value."""
        found = await self.ask(
            "Runtime.evaluate", expression=script, awaitPromise=True, returnByValue=True
        )
        if "exceptionDetails" in found:
            raise FailedError(
                f"chromium: {found['exceptionDetails']['text']}: {script:.80}"
            )
        return found["result"].get("value")

    async def wait_for(self, condition: str) -> None:
        """Wait until an expression is true."""
        async with asyncio.timeout(ANSWER_WITHIN_S):
            while not await self.run(f"!!({condition})"):  # noqa: ASYNC110 - the page calls nobody
                await asyncio.sleep(0.05)

    async def main_thread_s(self) -> float:
        """Return the processor time of the main thread so far [s]."""
        metrics = (await self.ask("Performance.getMetrics"))["metrics"]
        return float(next(m["value"] for m in metrics if m["name"] == "TaskDuration"))

    async def heap_bytes(self) -> float:
        """Return the size of the heap after a collection."""
        await self.ask("HeapProfiler.collectGarbage")
        return float((await self.ask("Runtime.getHeapUsage"))["usedSize"])

    async def traced(self, seconds: float) -> list[dict[str, Any]]:
        """Return the events of the time line over `seconds`."""
        self._trace, self._traced = [], asyncio.Event()
        config = {"includedCategories": ["devtools.timeline", "__metadata"]}
        await self.ask("Tracing.start", transferMode="ReportEvents", traceConfig=config)
        await asyncio.sleep(seconds)
        await self.ask("Tracing.end")
        async with asyncio.timeout(ANSWER_WITHIN_S):
            await self._traced.wait()
        return self._trace

    async def _read(self) -> None:
        async for message in self._socket:
            data = json.loads(message.data)
            if (answer := self._answers.pop(data.get("id"), None)) is not None:
                answer.set_result(data)
            elif data.get("method") == "Tracing.dataCollected":
                self._trace += data["params"]["value"]
            elif data.get("method") == "Tracing.tracingComplete":
                self._traced.set()

    async def close(self) -> None:
        """Close the tab."""
        with contextlib.suppress(FailedError, ConnectionError):
            await self.ask("Page.close")
        self._reading.cancel()
        await self._socket.close()


@contextlib.asynccontextmanager
async def browser() -> AsyncIterator[tuple[aiohttp.ClientSession, int]]:
    """Run Chromium; give what `Tab.open` takes.

    Raises
    ------
    FailedError
        If there is none, or it does not start.
    """
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    if program is None:
        raise FailedError(
            "chromium is needed: install the package chromium, or use --no-browser"
        )
    with tempfile.TemporaryDirectory(
        prefix="hilserver-", ignore_cleanup_errors=True
    ) as folder:
        quiet = {
            "stdout": asyncio.subprocess.DEVNULL,
            "stderr": asyncio.subprocess.DEVNULL,
        }
        command = [program, *_ARGUMENTS, f"--user-data-dir={folder}", "about:blank"]
        async with started(command, name="chromium", stop_limit_s=10.0, **quiet):
            port = await _port(Path(folder) / "DevToolsActivePort")
            async with aiohttp.ClientSession() as session:
                yield session, port


async def _port(path: Path) -> int:
    for _ in range(round(START_WITHIN_S / 0.1)):
        if (port := _first_line(path)) is not None:
            return int(port)
        await asyncio.sleep(0.1)
    raise FailedError(f"chromium did not start within {START_WITHIN_S:g} s")


def _first_line(path: Path) -> str | None:
    try:
        return next(iter(path.read_text(encoding="ascii").splitlines()), None)
    except OSError:
        return None
