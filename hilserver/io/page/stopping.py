"""Stop from the page: pressed in shared memory first, reported to the daemon afterwards.

The compiled step obeys the press, so that neither the daemon's event loop nor its OPC UA server is
needed; the daemon is informed afterwards, for its event and its audit. What confirms the press is a
frame that shows it: the word in shared memory is there even if nothing runs.
"""

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable
from functools import partial

from hilserver.errors import FailedError
from hilserver.image import ImageReader, press_stop
from hilserver.io.page.browsers import Browser
from hilserver.io.page.hand import RefusedError
from hilserver.tasks import SupervisedTask, Supervisor

_log = logging.getLogger(__name__)

SHOWN_S = 0.9
_LOOK_S = 0.02
_COMMAND, _STOPS = "internal.command", 2  # what the step obeys, which no Python writes
Shown = Callable[[float], Awaitable[bool]]
"""Whether a frame shows the press, within so many seconds."""


class Stopping:
    """Presses Stop for browsers whose role allows it.

    `report` also calls Stop of the daemon; RefusedError if that fails.
    """

    def __init__(
        self,
        image: str,
        reader: ImageReader,
        report: Callable[[Browser], Awaitable[None]],
        tasks: Supervisor | None = None,
    ) -> None:
        self._image, self._reader, self._report = image, reader, report
        self._tasks = Supervisor() if tasks is None else tasks
        signals = reader.description["signals"]
        self._slot = next(s["slots"][0] for s in signals if s["name"] == _COMMAND)
        self._reporting: dict[Browser, SupervisedTask] = {}

    def press(self, browser: Browser) -> Shown:
        """Stop the robot; return what tells whether the plant shows that the press is in force.

        RefusedError if the role of its user does not allow this, or there is no daemon.
        """
        if not browser.may_stop:
            raise RefusedError("your role does not allow this")
        head = self._reader.head
        try:
            press_stop(self._image)
        except FailedError as error:
            raise RefusedError(str(error)) from None
        if browser not in self._reporting:
            job = self._tasks.spawn(partial(self._say, browser), "report of a stop")
            self._reporting[browser] = job
            job.on_end = lambda: self._reporting.pop(browser, None)

        async def shown(within_s: float) -> bool:
            until_s = time.monotonic() + within_s
            while not self._is_shown(head):
                if time.monotonic() > until_s:
                    return False
                await asyncio.sleep(_LOOK_S)
            return True

        return shown

    def _is_shown(self, since: int) -> bool:
        """Whether a frame after so many shows the drive that stops."""
        frame = self._reader.latest()
        return (
            frame is not None
            and frame.number >= since
            and frame.values[self._slot] == _STOPS
        )

    async def _say(self, browser: Browser) -> None:
        user = browser.user or "anonymous"
        try:
            await self._report(browser)
            _log.info("page: %s calls Stop", user)
        except RefusedError as error:
            _log.info("page: %s has stopped; the daemon has no report: %s", user, error)
