"""Tasks that outlive the call that starts them: one supervisor keeps them, none ends silently.

A task has a name and, if it loops, a heartbeat. One that lasts begins again, with growing pauses,
whatever ends it: an exception, a cancellation by somebody else, a return. One that ends by itself
may return. Every other end is reported and counted:

    tasks = Supervisor(tell)
    job = tasks.keep("edge", self._stay_connected)            # begins again, with pauses
    tasks.every("edge: watch", WATCH_S, self._look)           # a loop with a heartbeat
    tasks.spawn(partial(self._serve, reader), "connection")   # ends by itself
    await job.end()

Within a call, `first_of` and `together` run several coroutines. Nothing else makes tasks.
"""

import asyncio
import inspect
import logging
from collections import Counter
from collections.abc import Callable, Coroutine
from dataclasses import dataclass
from typing import Any, Final, Self

from hilserver.time_limit import AbandonedError

FIRST_PAUSE_S: Final = 0.1
LONGEST_PAUSE_S: Final = 5.0
# a task that has run for so long begins again after the first pause
LASTED_S: Final = 10.0
BEATS_MISSED: Final = 10
SILENT_AT_LEAST_S: Final = 10.0

Make = Callable[[], Coroutine[Any, Any, Any]]

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Ended:
    """A task ended, or hangs."""

    name: str
    why: str
    error: BaseException | None = None
    again_in_s: float | None = None  # None: it does not begin again

    def __str__(self) -> str:
        if self.again_in_s is None:
            again = ""
        else:
            again = f"; it begins again in {self.again_in_s:g} s"
        return f"task '{self.name}' {self.why}{again}"


def _log_end(ended: Ended) -> None:
    _log.error("%s", ended, exc_info=ended.error)


class SupervisedTask:
    """One task of a supervisor, through all its restarts."""

    def __init__(
        self,
        supervisor: "Supervisor",
        name: str,
        make: Make,
        *,
        lasting: bool = True,
        silent_after_s: float | None = None,
    ) -> None:
        self.name = name
        self.lasting = lasting
        self.why_down = ""  # why it does not run, although it should
        self.task: asyncio.Task[Any]
        self.done = False  # it has ended and does not begin again
        self.on_end: Callable[[], object] = lambda: None  # called then
        self._supervisor = supervisor
        self._make = make
        self._silent_after_s = silent_after_s
        self._is_cancelled = False
        self._pause_s = FIRST_PAUSE_S
        self._loop = asyncio.get_running_loop()
        self._begin()

    def _begin(self) -> None:
        self._timer: asyncio.TimerHandle | None = None
        self.why_down = ""
        self._begun_s = self._beat_s = self._loop.time()
        self.task = self._loop.create_task(self._make(), name=self.name)
        self.task.add_done_callback(self._ended)

    def beat(self) -> None:
        """Say that the loop still turns."""
        self._beat_s = self._loop.time()

    def check_beat(self, now_s: float) -> None:
        """Cancel the task if its loop hangs; it then begins again."""
        silent_s = now_s - self._beat_s
        if (
            self._silent_after_s is None
            or self.why_down
            or silent_s <= self._silent_after_s
        ):
            return
        self.why_down = f"has not turned for {silent_s:.0f} s"
        # Reported now, because it may swallow the cancellation.
        self._supervisor.tell(Ended(self.name, self.why_down))
        self.task.cancel()

    def cancel(self) -> None:
        """End it, without waiting; it does not begin again."""
        self._is_cancelled = True
        if not self.task.done():
            self.task.cancel()
        elif self._timer is not None:
            self._timer.cancel()
            self._close()

    async def end(self) -> None:
        """End it and wait until it has ended."""
        self.cancel()
        if self.task is not asyncio.current_task():
            await asyncio.wait({self.task})

    def _ended(self, task: asyncio.Task[Any]) -> None:
        error = None if task.cancelled() else task.exception()
        has_returned = error is None and not task.cancelled()
        if self._is_cancelled or (has_returned and not self.lasting):
            self._close()
            return
        if error is not None:
            self.why_down = f"failed: {type(error).__name__}: {error}"
        elif has_returned:
            self.why_down = "returned"
        else:
            self.why_down = self.why_down or "was cancelled from outside"
        again_in_s = None
        if self.lasting:
            if self._loop.time() - self._begun_s > LASTED_S:
                self._pause_s = FIRST_PAUSE_S
            again_in_s = self._pause_s
            self._pause_s = min(2 * self._pause_s, LONGEST_PAUSE_S)
            # A timer, because nobody can cancel it by mistake.
            self._timer = self._loop.call_later(again_in_s, self._begin)
        self._supervisor.note(self, Ended(self.name, self.why_down, error, again_in_s))
        if not self.lasting:
            self._close()

    def _close(self) -> None:
        self.done = True
        self._supervisor.jobs.pop(self, None)
        self.on_end()


class Supervisor:
    """Keeps tasks; as a context manager it ends them.

    `tell` takes every end that nobody asked for; by default it is logged.
    """

    def __init__(self, tell: Callable[[Ended], object] = _log_end) -> None:
        self.tell = tell
        self.jobs: dict[SupervisedTask, None] = {}  # in the order of their start
        # by name, 0 for those that never ended unasked
        self.restarts: Counter[str] = Counter()  # of tasks that last
        self.failures: Counter[str] = Counter()  # of tasks that end by themselves
        self._looked_s = 0.0

    def keep(
        self, name: str, make: Make, silent_after_s: float | None = None
    ) -> SupervisedTask:
        """Run `make()` until `SupervisedTask.end` is called."""
        self.restarts[name] += 0
        return self._started(
            SupervisedTask(self, name, make, silent_after_s=silent_after_s)
        )

    def every(
        self, name: str, period_s: float, look: Callable[[], object]
    ) -> SupervisedTask:
        """Call `look`, which may be a coroutine function, every `period_s` until it is ended."""

        async def turn() -> None:
            while True:
                found = look()
                if inspect.isawaitable(found):
                    await found
                job.beat()
                await asyncio.sleep(period_s)

        job = self.keep(name, turn, max(BEATS_MISSED * period_s, SILENT_AT_LEAST_S))
        return job

    def spawn(self, make: Make, name: str, *, lasting: bool = False) -> SupervisedTask:
        """Run `make()`, which ends by itself, or begins again if it is `lasting`.

        `name` tells what it does, not for whom: it becomes a label of metrics.
        """
        if lasting:
            return self.keep(name, make)
        self.failures[name] += 0
        return self._started(SupervisedTask(self, name, make, lasting=False))

    def _started(self, job: SupervisedTask) -> SupervisedTask:
        self.jobs[job] = None
        return job

    def look(self) -> None:
        """Check the heartbeats; called about every second."""
        now_s = asyncio.get_running_loop().time()
        # If the whole event loop stood still, no task is to blame.
        is_on_time = now_s - self._looked_s < SILENT_AT_LEAST_S / 2
        self._looked_s = now_s
        for job in tuple(self.jobs) if is_on_time else ():
            job.check_beat(now_s)

    def up(self) -> dict[str, bool]:
        """Return whether each task that should last runs."""
        return {job.name: not job.why_down for job in self.jobs if job.lasting}

    def why_down(self) -> str:
        """Return in words which task does not run although it should; empty if all do."""
        down = (
            f"task '{job.name}' {job.why_down}" for job in self.jobs if job.why_down
        )
        return next(down, "")

    def note(self, job: SupervisedTask, ended: Ended) -> None:
        """Count an end that nobody asked for, and tell it."""
        (self.restarts if job.lasting else self.failures)[job.name] += 1
        self.tell(ended)

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.end()

    async def end(self) -> None:
        """End all tasks that are left."""
        left = tuple(self.jobs)
        for job in left:
            job.cancel()
        running = {job.task for job in left} - {asyncio.current_task()}
        if running:
            await asyncio.wait(running)


async def end(*tasks: asyncio.Future[Any] | None) -> None:
    """Cancel tasks and wait until they have ended in any way."""
    running = [task for task in tasks if task is not None]
    for task in running:
        task.cancel()
    await asyncio.gather(*running, return_exceptions=True)


async def first_of(
    *works: Coroutine[Any, Any, Any], within_s: float | None = None
) -> int | None:
    """Run coroutines until the first one ends; end the others.

    Return its position, None if the time is up; raise its error, AbandonedError if it was
    cancelled by somebody else.
    """
    tasks = [asyncio.ensure_future(work) for work in works]
    try:
        done, _ = await asyncio.wait(
            tasks, timeout=within_s, return_when=asyncio.FIRST_COMPLETED
        )
    finally:
        await end(*tasks)
    for position, task in enumerate(tasks):
        if task not in done:
            continue
        if task.cancelled():
            raise AbandonedError(f"{_name(works[position])} was cancelled from outside")
        task.result()
        return position
    return None


async def together(*works: Coroutine[Any, Any, Any]) -> None:
    """Run coroutines that last: raise what ended the first one, after the others have ended."""
    first = await first_of(*works)
    assert first is not None
    raise AbandonedError(f"{_name(works[first])} returned")


def _name(work: Coroutine[Any, Any, Any]) -> str:
    return str(getattr(work, "__qualname__", work))
