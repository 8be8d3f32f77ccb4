"""Who keeps the tasks of a server: the program that uses it, or nobody in particular."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any, Protocol

from hilserver.opcua.logs import log

_AGAIN_S = 1.0

Make = Callable[[], Coroutine[Any, Any, Any]]


class Running(Protocol):
    """A task that runs."""

    def cancel(self) -> object:
        """End it, without waiting."""

    async def end(self) -> None:
        """End it and wait until it has ended."""


class Spawn(Protocol):
    """Runs `make()` as a task; one that is `lasting` begins again whatever ends it."""

    def __call__(self, make: Make, name: str, *, lasting: bool = False) -> Running:
        """Start it."""


class _Plain:
    """A task of asyncio; an end that nobody asked for is logged."""

    def __init__(self, make: Make, name: str, *, lasting: bool) -> None:
        self._make = make
        self._name = name
        self._lasting = lasting
        self._is_cancelled = False
        self._begin()

    def _begin(self) -> None:
        if self._is_cancelled:
            return
        self._task = asyncio.get_running_loop().create_task(
            self._make(), name=self._name
        )
        self._task.add_done_callback(self._ended)

    def _ended(self, task: asyncio.Task[Any]) -> None:
        error = "cancelled" if task.cancelled() else task.exception()
        if self._is_cancelled or (error is None and not self._lasting):
            return
        log.error("opcua task ended", task=self._name, error=repr(error))
        if self._lasting:
            task.get_loop().call_later(_AGAIN_S, self._begin)

    def cancel(self) -> None:
        self._is_cancelled = True
        self._task.cancel()

    async def end(self) -> None:
        self.cancel()
        await asyncio.wait({self._task})


def spawn_plainly(make: Make, name: str, *, lasting: bool = False) -> Running:
    """Start a task in a program that has no supervisor."""
    return _Plain(make, name, lasting=lasting)
