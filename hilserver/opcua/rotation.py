"""Turns on the event loop for the work of clients, so that control of the robot comes first.

The event loop also does what drives the robot: the answers of peers, the supervision of their
silence. Requests and subscriptions are jobs, done in portions of `PORTION_S`. The job that has used
least time is next: a costly request waits for short ones of others, not the other way round. After
`BUDGET_S` all rest for `REST_S`, in which the loop does other work. So a client that causes more
load waits itself.
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
"""Work that yields wherever it may be interrupted; a yielded value is awaited."""


class TurnTaker(Protocol):
    """Something that needs turns."""

    # time its turns have taken, counted here; a new job starts at the level of the others [s]
    used_s: float

    def turn(self) -> bool:
        """Do one portion; return whether there is more to do."""
        ...


def advance(work: Portions, answer: Any = None) -> Any:
    """Do one portion of `work`; return what it waits for, if anything.

    `answer` is the result of what it waited for; an exception is raised in it. StopIteration has
    the result of `work`.
    """
    end_s = time.monotonic() + PORTION_S
    while True:
        if isinstance(answer, Exception):
            wanted = work.throw(answer)
        else:
            wanted = work.send(answer)
        if wanted is not None or time.monotonic() >= end_s:
            return wanted
        answer = None


class Rotation:
    """Gives turns to jobs: the one that has used least time is next."""

    def __init__(self) -> None:
        self._queue: list[tuple[float, int, TurnTaker]] = []
        self._waiting: dict[TurnTaker, int] = {}
        self._least_s = 0.0
        self._numbers = itertools.count()
        self._handle: asyncio.Handle | None = None

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, job: TurnTaker) -> None:
        """Give a job turns until it has nothing more to do; no effect if it already waits."""
        if job in self._waiting:
            return
        # A job without work earns no credit for later.
        used_s = job.used_s = max(getattr(job, "used_s", 0.0), self._least_s)
        self._waiting[job] = number = next(self._numbers)
        heapq.heappush(self._queue, (used_s, number, job))
        if self._handle is None:
            self._handle = asyncio.get_running_loop().call_soon(self._run)

    def drop(self, job: TurnTaker) -> None:
        """Give a job no more turns."""
        self._waiting.pop(job, None)

    def run_now(self) -> None:
        """Start at once, even during a rest."""
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
            except Exception as error:  # noqa: BLE001 - one client's error must not affect others
                log.warning("opcua job failed", error=repr(error)[:200])
            now_s = time.monotonic()
            job.used_s = self._least_s + max(now_s - began_s, _LEAST_TURN_S)
            began_s = now_s
            if is_more:
                self.add(job)
        loop = asyncio.get_running_loop()
        self._handle = loop.call_later(REST_S, self._run) if self._queue else None
