"""The interface of every pacing back end, and what it needs from the scheduler."""

from collections.abc import Callable
from enum import StrEnum
from typing import Protocol

from hilserver.scheduler.realtime import AuditFinding


class StopReason(StrEnum):
    """Why the scheduler has ended."""

    STOPPED = "stopped"
    OVERRUN = "overrun"
    CRASHED = "crashed"


class Pacing(Protocol):
    """A back end: decides when the machine's `turn` is called, and nothing else."""

    @property
    def thread_id(self) -> int:
        """The operating system's number of the pacing thread; 0: there is none."""

    async def start(self) -> list[AuditFinding]:
        """Start pacing; return what the operating system granted."""

    async def stop(self) -> None:
        """Stop pacing (the stop request has been made) and release every resource."""

    def wake(self) -> None:
        """Look at the control words soon (a command has been given)."""


Rung = Callable[[], None]  # called on the event loop when the machine has news

# called on the event loop once, when pacing has ended
Ended = Callable[[StopReason], None]
