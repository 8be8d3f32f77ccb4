"""Parts: the daemon starts them one after the other and stops all at once, each with a limit."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import structlog

STOP_LIMIT_S = 1.0
_log = structlog.get_logger(__name__)


class Wing(Protocol):
    """A server, or a link to somebody else."""

    @property
    def address(self) -> str:
        """Where it is reached, or whom it reaches."""

    async def start(self) -> None:
        """Begin; who is at the other end may come later."""

    async def stop(self) -> None:
        """End, also a start that was not completed."""


@dataclass(frozen=True)
class Part:
    """A wing and its place in the daemon.

    Attributes
    ----------
    section : str
        Of the configuration; complaints name it.
    label : str
        What people call it.
    is_early : bool
        Starts before the first tick.
    """

    section: str
    label: str
    wing: Wing
    is_early: bool = False


async def stop_all(parts: Sequence[Part]) -> None:
    """Stop all parts side by side; one that fails or hangs holds up no other."""
    await asyncio.gather(*(_stop(part) for part in parts))


async def _stop(part: Part) -> None:
    task = asyncio.ensure_future(part.wing.stop())
    await asyncio.wait({task}, timeout=STOP_LIMIT_S)
    if not task.done():
        task.cancel()  # and not waited for: a library may swallow it
        _log.warning("did not stop in time and was left", part=part.label)
    elif not task.cancelled() and (error := task.exception()) is not None:
        _log.error("failed to stop", part=part.label, error=f"{type(error).__name__}: {error}")
