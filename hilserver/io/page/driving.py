"""Which browser drives, and the path of its commands: one at a time, only on a fresh picture."""

import asyncio
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from hilserver.io.page.browsers import Browser
from hilserver.io.page.frames import age_ms
from hilserver.io.page.hand import RefusedError
from hilserver.plant.layout import WHEELS
from hilserver.signals.numbers import is_finite_number

BOARD_S = 1.5  # writing and sending the board each take up to half a second
_MODES = {"wheels": 0, "twist": 1}


class Seat(Protocol):
    """A socket whose user may take the wheel."""

    number: int
    browser: Browser

    def tell(self, message: Mapping[str, Any]) -> None:
        """Send a message."""


@dataclass(frozen=True)
class PageCommand:
    """Set-points, checked: signal to value."""

    values: Mapping[str, float | str]

    @property
    def is_zero(self) -> bool:
        """Whether all set-points are zero."""
        return not any(v for name, v in self.values.items() if name != "control.mode")

    @classmethod
    def parse(cls, data: Mapping[str, Any]) -> "PageCommand":
        """Return the command of a message; RefusedError if it is not one."""
        mode = data.get("mode")
        numbers: list[Any] = []
        if mode == "twist":
            names = ["twist.linear_m_s", "twist.angular_rad_s"]
            numbers = [data.get("linear"), data.get("turn")]
        elif mode == "wheels":
            names = [f"wheel.{wheel}.setpoint_rpm" for wheel in WHEELS]
            given = data.get("rpm")
            numbers = given if isinstance(given, list) else []
        else:
            raise RefusedError("the mode of a command is 'twist' or 'wheels'")
        if len(numbers) != len(names) or not all(map(is_finite_number, numbers)):
            raise RefusedError("a command must contain finite numbers")
        values = {n: float(v) for n, v in zip(names, numbers, strict=True)}
        return cls({"control.mode": _MODES[mode], **values})


_REST = PageCommand.parse({"mode": "twist", "linear": 0, "turn": 0})
_RELEASE = PageCommand({"control.source": "nobody"})


class PageDriving:
    """Hands the newest command of the driver to the daemon; older ones are dropped, never queued.

    Only that the hand was at rest in between is not: after a Reset the daemon waits for it.
    Commands on a picture older than `deadman_ms` are refused; held ones are ended by the daemon.
    """

    def __init__(self, deadman_ms: float) -> None:
        self.driver: Seat | None = None
        self._deadman_ms = deadman_ms
        self._next: PageCommand | None = None
        self._rests = False  # a zero came before it, which the daemon has to see
        self._news = asyncio.Event()
        self._taken_s = -math.inf
        # what one browser sent is completed before another's turn
        self._turn = asyncio.Lock()

    @property
    def is_new(self) -> bool:
        """Whether control was taken so recently that the board may not show it yet."""
        return time.monotonic() - self._taken_s < BOARD_S

    async def take(self, seat: Seat, check: Callable[[], None] = lambda: None) -> None:
        """Give the wheel to `seat`, and control to the page; RefusedError if that is not allowed.

        `check`: may raise RefusedError; called when it is its turn, after earlier requests.
        """
        if not seat.browser.hand.rights.drive:
            raise RefusedError("your role does not allow driving")
        async with self._turn:
            check()
            await seat.browser.hand.write({"control.source": "page"})
            before, self.driver, self._next, self._rests = (
                self.driver,
                seat,
                None,
                False,
            )
            self._taken_s = time.monotonic()
        if before is not None and before is not seat:
            before.tell(
                {"type": "refused", "text": "another browser has taken control"}
            )

    def command(self, seat: Seat, data: Mapping[str, Any]) -> None:
        """Take a command of `seat`; RefusedError if it does not drive or its picture is too old."""
        command = PageCommand.parse(data)
        if seat is not self.driver:
            raise RefusedError("you do not have control: take control first")
        seen = data.get("seen")
        is_fresh = isinstance(seen, int) and age_ms(seen) <= self._deadman_ms
        if not is_fresh and not command.is_zero:
            raise RefusedError("the page's data is too old to drive by")
        self._next = command
        self._rests |= command.is_zero
        self._news.set()

    def leave(self, seat: Seat) -> None:
        """Let go of the wheel, and give control back."""
        if seat is self.driver:
            self._next = _RELEASE
            self._news.set()

    async def run(self) -> None:
        """Hand over commands, one at a time, until cancelled."""
        while True:
            await self._news.wait()
            self._news.clear()
            async with self._turn:
                command, seat = self._next, self.driver
                if command is not None and seat is not None:
                    self._next, rests, self._rests = None, self._rests, False
                    if rests and not command.is_zero:
                        await self._hand_over(_REST, seat)
                    await self._hand_over(command, seat)

    async def _hand_over(self, command: PageCommand, seat: Seat) -> None:
        try:
            if (
                command is _RELEASE
            ):  # stop at once, as handing over control would only ramp down
                self.driver = None
                await seat.browser.hand.write(_REST.values)
            await seat.browser.hand.write(command.values)
        except RefusedError as error:
            seat.tell({"type": "refused", "text": str(error)})
