"""Turns on the event loop for all that clients ask of the server, so that control comes first.

The event loop also carries what drives the robot: the answers of peers, the supervision of their
silence. Requests and subscriptions are jobs that take turns, one bounded portion each; after
`BUDGET_S` they rest for `REST_S`, in which the loop does whatever else is due. More load makes
subscribers wait longer, and nobody else.
"""

import asyncio
import time
from collections import deque
from typing import Protocol

from hilserver.io.opcua_server.logs import log

BUDGET_S = 0.002
REST_S = 0.001


class Job(Protocol):
    """Something that needs turns."""

    def turn(self) -> bool:
        """Do one portion; return whether there is more to do."""
        ...


class Rotation:
    """Gives turns to jobs, in the order in which they came."""

    def __init__(self) -> None:
        self._jobs: deque[Job] = deque()
        self._waiting: set[Job] = set()
        self._handle: asyncio.Handle | None = None

    def __len__(self) -> int:
        return len(self._jobs)

    def add(self, job: Job) -> None:
        """Give a job turns until it has nothing more to do; harmless if it waits already."""
        if job in self._waiting:
            return
        self._waiting.add(job)
        self._jobs.append(job)
        if self._handle is None:
            self._handle = asyncio.get_running_loop().call_soon(self._run)

    def drop(self, job: Job) -> None:
        """Give a job no more turns."""
        if job in self._waiting:
            self._waiting.discard(job)
            self._jobs.remove(job)

    def run_now(self) -> None:
        """Begin at once, also in a rest."""
        if self._handle is not None:
            self._handle.cancel()
            self._run()

    def _run(self) -> None:
        end_s = time.monotonic() + BUDGET_S
        while self._jobs:
            job = self._jobs.popleft()
            self._waiting.discard(job)
            try:
                if job.turn():
                    self._waiting.add(job)
                    self._jobs.append(job)
            except Exception as error:  # noqa: BLE001 - one client's trouble is not the others'
                log.warning("opcua job failed", error=repr(error)[:200])
            if time.monotonic() >= end_s:
                break
        loop = asyncio.get_running_loop()
        self._handle = loop.call_later(REST_S, self._run) if self._jobs else None
