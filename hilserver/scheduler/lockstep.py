"""Lockstep: the simulation waits for an external controller, and reports one that stays silent."""

import asyncio
from collections.abc import Awaitable
from typing import TypeVar

from hilserver.errors import FailedError

T = TypeVar("T")


class PeerSilentError(FailedError):
    """The other side of a lockstep did not answer in time."""


async def wait_for_peer(answer: Awaitable[T], *, peer: str, timeout_s: float, tick: int) -> T:
    """Wait for the peer's `answer` to the outputs of `tick`.

    PeerSilentError after `timeout_s` [s]; names the peer and the tick.
    """
    try:
        async with asyncio.timeout(timeout_s):
            return await answer
    except TimeoutError:
        raise PeerSilentError(
            f"lockstep: {peer} has been silent for {timeout_s:g} s, tick {tick} is waiting for it; "
            f"is it running and connected?"
        ) from None
