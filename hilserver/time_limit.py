"""How long we wait for somebody else: the one limit for every wait.

`asyncio.timeout` of Python 3.11 converts the exact `CancelledError` only. asyncua waits by
`wait_for2`, which raises a subclass when the answer and the cancellation meet in one turn of the
loop: that would pass for a cancellation of the task, and the task would end without a word. And
libraries cancel their own futures when a connection breaks: nobody asked our task to end then.
"""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Final

_TURN_S: Final = 0.05
"""How often a limit that counts our own time looks whether the loop turns."""


class AbandonedError(ConnectionError):
    """A library cancelled what we waited for; nobody asked this task to end."""


@contextlib.asynccontextmanager
async def time_limit(
    limit_s: float | None, *, at_most_s: float | None = None
) -> AsyncIterator[None]:
    """Raise TimeoutError after `limit_s` (None: never), AbandonedError if a library gives up.

    With `at_most_s`, time in which our own event loop could not turn does not count: a quota or
    other programs then prolong the wait, up to this. A cancellation of this task passes through.
    """
    task = asyncio.current_task()
    asked = 0 if task is None else task.cancelling()
    try:
        async with asyncio.timeout(limit_s if at_most_s is None else None) as wait:
            prolonging = None
            if limit_s is not None and at_most_s is not None:
                prolonging = _Prolonging(wait, limit_s, at_most_s)
            try:
                yield
            except asyncio.CancelledError as error:
                if type(error) is asyncio.CancelledError:
                    raise
                raise asyncio.CancelledError(str(error)) from error
            finally:
                if prolonging is not None:
                    prolonging.stop()
    except asyncio.CancelledError as error:
        # Whoever cancels a task is counted by it; a future that a library cancels is not.
        if task is None or task.cancelling() > asked:
            raise
        raise AbandonedError("the wait for an answer was abandoned") from error


class _Prolonging:
    """Ends a wait after its limit, without the time that the loop loses, until it is stopped.

    `asyncio.timeout` itself has no limit here: it would be first where both are due.
    """

    def __init__(self, wait: asyncio.Timeout, limit_s: float, at_most_s: float) -> None:
        self._wait = wait
        self._loop = asyncio.get_running_loop()
        self._timer: asyncio.TimerHandle | None = None
        self._due_s = self._loop.time()
        self._ends_s = self._due_s + limit_s
        self._last_s = self._due_s + at_most_s
        self._look()

    def _look(self) -> None:
        now_s = self._loop.time()
        lost_s = now_s - self._due_s
        if lost_s > _TURN_S:
            # What has come meanwhile is still to be read: one look more at least.
            ends_s = max(self._ends_s + lost_s, now_s + _TURN_S)
            self._ends_s = min(ends_s, self._last_s)
        if now_s >= self._ends_s:
            self._wait.reschedule(now_s)
            return
        self._due_s = min(now_s + _TURN_S, self._ends_s)
        self._timer = self._loop.call_at(self._due_s, self._look)

    def stop(self) -> None:
        """Leave the wait as it is."""
        if self._timer is not None:
            self._timer.cancel()
