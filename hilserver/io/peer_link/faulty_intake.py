"""The intake behind a link with injected faults: batches come late, in another order or never."""

import asyncio
import time
from collections.abc import Iterable

from hilserver.faults.links import Lane, Line
from hilserver.io.peer_link.intake import Intake
from hilserver.io.peer_link.samples import Verdict

Batch = list[tuple[str, Verdict]]


class FaultyIntake:
    """Hands batches on at once while the link has no faults."""

    def __init__(self, intake: Intake, line: Line) -> None:
        self._intake = intake
        self._lane: Lane[Batch] = Lane(line, "in")
        self._news = asyncio.Event()

    def missing(self, node: str, why: str, now_ns: int) -> None:
        """Name a node that the peer does not have."""
        self._intake.missing(node, why, now_ns)

    def receive(self, samples: Iterable[tuple[str, Verdict]], now_ns: int) -> None:
        """Take one batch; what is not late is handed on here and now."""
        self._lane.put(list(samples))
        for batch in self._lane.take():
            self._intake.receive(batch, now_ns)
        self._news.set()

    async def run(self) -> None:
        """Hand late batches on when they arrive, until the session ends."""
        while True:
            await self._wait()
            for batch in self._lane.take():
                self._intake.receive(batch, time.monotonic_ns())

    async def _wait(self) -> None:
        wait_s = self._lane.next_s
        if wait_s is not None:
            await asyncio.sleep(wait_s)
            return
        await self._news.wait()
        self._news.clear()
