"""Turns on the event loop for all that clients ask of the server, so that control comes first.

The event loop also carries what drives the robot: the answers of peers, the supervision of their
silence. Requests and subscriptions are jobs; each is done in portions of `PORTION_S`, and who has
used least is next: a costly request waits for the short ones of others and not they for it. After
`BUDGET_S` all rest for `REST_S`, in which the loop does whatever else is due. More load makes those
wait who make it.
"""

import asyncio
import heapq
import itertools
import time
from collections.abc import Generator
from typing import Any, Protocol

from hilserver.opcua.logs import log

BUDGET_S = 0.002
REST_S = 0.001
PORTION_S = 0.0005
_LEAST_TURN_S = 20e-6

Portions = Generator[Any, Any, Any]
"""Work that yields wherever it may give way; what it yields, if anything, is awaited."""


class Job(Protocol):
    """Something that needs turns."""

    # what its turns have taken, counted here; whoever has none begins as the others stand [s]
    used_s: float

    def turn(self) -> bool:
        """Do one portion; return whether there is more to do."""
        ...


def advance(work: Portions, answer: Any = None) -> Any:
    """Do one portion of `work`; return what it waits for, if anything.

    It gets `answer` for what it waited for, an exception is raised in it; StopIteration has the
    result.
    """
    end_s = time.monotonic() + PORTION_S
    while True:
        wanted = work.throw(answer) if isinstance(answer, Exception) else work.send(answer)
        if wanted is not None or time.monotonic() >= end_s:
            return wanted
        answer = None


class Rotation:
    """Gives turns to jobs: whoever has used least is next."""

    def __init__(self) -> None:
        self._queue: list[tuple[float, int, Job]] = []
        self._waiting: dict[Job, int] = {}
        self._least_s = 0.0
        self._numbers = itertools.count()
        self._handle: asyncio.Handle | None = None

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, job: Job) -> None:
        """Give a job turns until it has nothing more to do; harmless if it waits already."""
        if job in self._waiting:
            return
        # Who had nothing to do saves nothing up for later.
        used_s = job.used_s = max(getattr(job, "used_s", 0.0), self._least_s)
        self._waiting[job] = number = next(self._numbers)
        heapq.heappush(self._queue, (used_s, number, job))
        if self._handle is None:
            self._handle = asyncio.get_running_loop().call_soon(self._run)

    def drop(self, job: Job) -> None:
        """Give a job no more turns."""
        self._waiting.pop(job, None)

    def run_now(self) -> None:
        """Begin at once, also in a rest."""
        if self._handle is not None:
            self._handle.cancel()
            self._run()

    def _run(self) -> None:
        began_s = time.monotonic()
        end_s = began_s + BUDGET_S
        while self._queue and began_s < end_s:
            self._least_s, number, job = heapq.heappop(self._queue)
            if self._waiting.get(job) != number:
                continue  # dropped
            del self._waiting[job]
            is_more = False
            try:
                is_more = job.turn()
            except Exception as error:  # noqa: BLE001 - one client's trouble is not the others'
                log.warning("opcua job failed", error=repr(error)[:200])
            now_s = time.monotonic()
            job.used_s = self._least_s + max(now_s - began_s, _LEAST_TURN_S)
            began_s = now_s
            if is_more:
                self.add(job)
        loop = asyncio.get_running_loop()
        self._handle = loop.call_later(REST_S, self._run) if self._queue else None
