"""Stop from the page: pressed in shared memory first, reported to the daemon afterwards.

The compiled step obeys the press, so that neither the daemon's event loop nor its OPC UA server is
needed; the daemon is informed afterwards, for its event and its audit.
"""

import logging
from collections.abc import Awaitable, Callable
from functools import partial

from hilserver.errors import FailedError
from hilserver.image import press_stop
from hilserver.io.page.browsers import Browser
from hilserver.io.page.hand import RefusedError
from hilserver.tasks import SupervisedTask, Supervisor

_log = logging.getLogger(__name__)


class Stopping:
    """Presses Stop for browsers whose role allows it.

    `report` also calls Stop of the daemon; RefusedError if that fails.
    """

    def __init__(
        self,
        image: str,
        report: Callable[[Browser], Awaitable[None]],
        tasks: Supervisor | None = None,
    ) -> None:
        self._image, self._report = image, report
        self._tasks = Supervisor() if tasks is None else tasks
        self._reporting: dict[Browser, SupervisedTask] = {}

    def press(self, browser: Browser) -> None:
        """Stop the robot; returns once the press is in force.

        RefusedError if the role of its user does not allow this, or there is no daemon.
        """
        if not browser.may_stop:
            raise RefusedError("your role does not allow this")
        try:
            press_stop(self._image)
        except FailedError as error:
            raise RefusedError(str(error)) from None
        if browser not in self._reporting:
            job = self._tasks.spawn(partial(self._say, browser), "report of a stop")
            self._reporting[browser] = job
            job.on_end = lambda: self._reporting.pop(browser, None)

    async def _say(self, browser: Browser) -> None:
        user = browser.user or "anonymous"
        try:
            await self._report(browser)
            _log.info("page: %s calls Stop", user)
        except RefusedError as error:
            _log.info("page: %s has stopped; the daemon has no report: %s", user, error)
