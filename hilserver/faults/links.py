"""Faults of a peer link: on the event loop, in wall time, with bounded queues.

A link fault falsifies when values arrive, never the values. The link's session stays as it is; only
``disconnect`` cuts it and keeps it from reconnecting.
"""

import asyncio
import random
import time
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from hilserver.faults.model import Fault

T = TypeVar("T")
MAX_QUEUED = 1024
QUEUE_LOOK_S = 0.01


class LinkFault:
    """One fault of a link, from when to when."""

    def __init__(self, fault: Fault, now_s: float) -> None:
        self.fault = fault
        self.from_s = now_s + fault.from_s
        self.until_s = None if fault.end_s is None else now_s + fault.end_s
        self.random = random.Random(fault.seed or 0)  # noqa: S311 - a series that can be repeated
        self._until_next_s = 0.0
        self._drops = False

    def is_over(self, now_s: float) -> bool:
        """Whether its time has passed."""
        return self.until_s is not None and now_s >= self.until_s

    def acts(self, now_s: float, direction: str) -> bool:
        """Whether it acts on what travels in `direction` now."""
        here = self.fault.direction in ("both", direction)
        return here and now_s >= self.from_s and not self.is_over(now_s)

    def drops(self, now_s: float) -> bool:
        """Whether a batch is lost; the answer holds for `every_s`."""
        if now_s >= self._until_next_s:
            self._drops = self.random.random() < (self.fault.probability or 0.0)
            self._until_next_s = now_s + (self.fault.every_s or 0.0)
        return self._drops

    def delay_s(self) -> float:
        """Return how late a batch comes [s]."""
        fault = self.fault
        if fault.fault == "reorder" and self.random.random() >= (
            fault.probability or 0.0
        ):
            return 0.0
        return (fault.delay_s or 0.0) + self.random.random() * (fault.jitter_s or 0.0)


class PeerLine:
    """The link to one peer, under its faults."""

    def __init__(
        self, name: str, clock_s: Callable[[], float] = time.monotonic
    ) -> None:
        self.name = name
        # batches that a fault dropped, and those for which the queue had no room
        self.lost = 0
        self.overflowed = 0
        self.now_s = clock_s
        self._faults: dict[str, LinkFault] = {}
        self._news = asyncio.Event()

    def inject(self, fault: Fault) -> None:
        """Let a fault act; one of the same name is replaced."""
        self._faults[fault.title] = LinkFault(fault, self.now_s())
        self._news.set()

    def clear(self, name: str | None = None) -> bool:
        """End the fault `name` or all; return whether there was one."""
        if name is None:
            had = bool(self._faults)
            self._faults = {}
            return had
        return self._faults.pop(name, None) is not None

    def active(self) -> list[tuple[Fault, bool]]:
        """Return the faults that wait or act, and whether they act now."""
        self._prune()
        now_s = self.now_s()
        return [(f.fault, now_s >= f.from_s) for f in self._faults.values()]

    def _prune(self) -> None:
        now_s = self.now_s()
        self._faults = {n: f for n, f in self._faults.items() if not f.is_over(now_s)}

    def _acting(self, direction: str) -> list[LinkFault]:
        if not self._faults:
            return []
        self._prune()
        now_s = self.now_s()
        return [f for f in self._faults.values() if f.acts(now_s, direction)]

    @property
    def is_cut(self) -> bool:
        """Whether the link is disconnected."""
        return any(f.fault.fault == "disconnect" for f in self._acting("both"))

    async def wait_cut(self) -> None:
        """Wait until the link is cut."""
        while not self.is_cut:
            await self._next_look()

    async def wait_whole(self) -> None:
        """Wait while the link is cut."""
        while self.is_cut:
            await self._next_look()

    async def _next_look(self) -> None:
        if self._faults:
            await asyncio.sleep(QUEUE_LOOK_S)  # faults begin and end on their own
            return
        await self._news.wait()
        self._news.clear()

    def fate(self, direction: str) -> tuple[bool, float, bool]:
        """Return what happens to a batch: lost, delay [s], may overtake others."""
        lost = False
        delay_s = 0.0
        overtakes = False
        for fault in self._acting(direction):
            if fault.fault.fault == "drop":
                lost |= fault.drops(self.now_s())
            elif fault.fault.fault != "disconnect":
                delay_s += fault.delay_s()
                overtakes |= fault.fault.fault == "reorder"
        self.lost += lost
        return lost, delay_s, overtakes


class Lane(Generic[T]):
    """Batches that travel in one direction, with the time of their arrival."""

    def __init__(self, line: PeerLine, direction: str) -> None:
        self._line = line
        self._direction = direction
        self._queue: deque[tuple[float, T]] = deque()
        self._last_due_s = 0.0

    def __len__(self) -> int:
        return len(self._queue)

    def put(self, batch: T) -> None:
        """Send a batch on its way."""
        lost, delay_s, overtakes = self._line.fate(self._direction)
        if lost:
            return
        if len(self._queue) >= MAX_QUEUED:
            self._line.overflowed += 1
            return
        due_s = self._line.now_s() + delay_s
        if not overtakes:
            due_s = max(due_s, self._last_due_s) if self._queue else due_s
            self._last_due_s = due_s
        self._queue.append((due_s, batch))

    def take(self) -> list[T]:
        """Return what has arrived, in the order of arrival."""
        now_s = self._line.now_s()
        due = sorted(
            (item for item in self._queue if item[0] <= now_s), key=lambda item: item[0]
        )
        self._queue = deque(item for item in self._queue if item[0] > now_s)
        return [batch for _, batch in due]

    @property
    def next_s(self) -> float | None:
        """Time until the next batch arrives [s]."""
        if not self._queue:
            return None
        first_s = min(item[0] for item in self._queue)
        return max(0.0, first_s - self._line.now_s())
