"""How long we wait for somebody else: the one limit for every wait.

`asyncio.timeout` of Python 3.11 converts the exact `CancelledError` only. asyncua waits by
`wait_for2`, which raises a subclass when the answer and the cancellation meet in one turn of the
loop: that would pass for a cancellation of the task, and the task would end without a word. And
libraries cancel their own futures when a connection breaks: nobody asked our task to end then.
"""

import asyncio
import contextlib
from collections.abc import AsyncIterator


class AbandonedError(ConnectionError):
    """A library cancelled what we waited for; nobody asked this task to end."""


@contextlib.asynccontextmanager
async def time_limit(limit_s: float | None) -> AsyncIterator[None]:
    """Raise TimeoutError after `limit_s` (None: never), AbandonedError if a library gives up.

    A cancellation of this task passes through.
    """
    task = asyncio.current_task()
    asked = 0 if task is None else task.cancelling()
    try:
        async with asyncio.timeout(limit_s):
            try:
                yield
            except asyncio.CancelledError as error:
                if type(error) is asyncio.CancelledError:
                    raise
                raise asyncio.CancelledError(str(error)) from error
    except asyncio.CancelledError as error:
        # Whoever cancels a task is counted by it; a future that a library cancels is not.
        if task is None or task.cancelling() > asked:
            raise
        raise AbandonedError("the wait for an answer was abandoned") from error
