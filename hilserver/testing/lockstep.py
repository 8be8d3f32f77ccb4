"""Lockstep: the robot under test waits for a controller that is a process of its own.

A tick passes when the test lets it pass (``yield 20``) and the controller has asked for it: by the
method Step of OPC UA, or by the service ``hilserver/step`` of ROS 2, which lasts until the next
messages. So neither the start of a process nor a busy computer takes simulated time, and every run
is the same. If one of them has ticks left and the other has none, time stands still.
"""

import asyncio
import contextlib
import os
import socket
import stat
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Final

from hilserver.daemon.daemon import Daemon
from hilserver.errors import ControlRefused
from hilserver.program.guest import Guest
from hilserver.time_limit import time_limit

__tracebackhide__ = True  # pytest then shows the failing line of the test
WAIT_FOR_STEP_S: Final = 60.0
LOOK_EVERY_S: Final = 0.5
LOOKS_WITH_NEWS: Final = 10
"""Whoever has written anew before so many looks, and not called Step, has a clock of its own."""
REMEDY: Final = (
    "in virtual time the robot waits for the Step of its controller"
    " (docs/tutorial/test-your-controller.md); one that has a clock of its own is tested with"
    " @pytest.mark.hil(mode='realtime')"
)

_ARRIVES: Final = {
    "opcua": "connect to hil.endpoint",
    "ros2": "have the ROS_DOMAIN_ID of the robot, and call the service hilserver/step",
}


class NotInStep(Exception):
    """The controller does not go on; the sentence says why."""


class Lockstep:
    """Lets time pass for a test and its controller together.

    Parameters
    ----------
    controller : Guest, optional
        The controller's process; None: somebody else has started it.
    door : str
        How it commands, ``opcua`` or ``ros2``.
    patience_s : float
        How long to wait for the next Step [s].
    """

    def __init__(
        self,
        daemon: Daemon,
        controller: Guest | None,
        patience_s: float,
        door: str = "opcua",
    ) -> None:
        # how often the controller has called Step; the first one of a node is made for it
        self.steps = -1 if door == "ros2" else 0
        self._scheduler, self._gate = daemon.scheduler, daemon.gate
        self._controller, self._looks_with_news = controller, 0
        self._patience_s, self._door = patience_s, door
        self._node = daemon.part("ros2") if door == "ros2" else None
        self._asked = 0  # ticks of the controller's Step that are still to come
        self._ends_after = 0  # that Step ends when so many ticks have run in all
        self._let = 0  # ticks that the test still lets pass
        self._has_asked = asyncio.Event()
        self._two = ""

    # --- the controller ---------------------------------------------------------------------------

    def step(self, n: int) -> None:
        """Ask for `n` ticks."""
        if self._scheduler.ticks_done < self._ends_after:
            self._two = (
                "a controller called Step before the ticks of the last Step had passed: it has to"
                " wait until sim.tick has risen by them, and only one controller may call it"
            )
            raise ControlRefused(self._two)
        self.steps += 1
        self._asked, self._ends_after = n, self._scheduler.ticks_done + n
        self._has_asked.set()
        self._go()

    def resume(self) -> None:
        """Do nothing: between two steps time stands still, whoever calls Start."""

    def pause(self) -> None:
        """Do nothing: time stands still already."""

    def set_speed(self, factor: float) -> None:
        """Pass the speed on, which virtual time does not have."""
        self._scheduler.set_speed(factor)

    # --- the test ---------------------------------------------------------------------------------

    async def advance(self, n: int) -> None:
        """Let `n` ticks pass, as soon as the controller asks for them.

        NotInStep if it does not.
        """
        self._let = n
        self._go()
        waits_since_s = time.monotonic()
        try:
            while self._let and not self._scheduler.finished.done():
                self._has_asked.clear()
                with contextlib.suppress(TimeoutError):
                    async with time_limit(LOOK_EVERY_S):
                        await self._has_asked.wait()
                if self._has_asked.is_set():
                    waits_since_s = time.monotonic()
                self.check(time.monotonic() - waits_since_s)
        finally:
            self._let = 0
        await self._scheduler.wait_paused()
        if self._two:
            raise NotInStep(self._two)

    async def settle(self) -> set[bytes]:
        """Let a node go whose last commands are here; return who it may have been.

        DDS tells late that somebody has gone, and nothing may come later: this waits until it asks
        for more, unless it has ended. NotInStep if it does not ask.
        """
        if self._node is None:
            return set()
        since_s = time.monotonic()
        while not self._asked and not (self._controller and self._controller.has_ended):
            self.check(time.monotonic() - since_s)
            self._has_asked.clear()
            with contextlib.suppress(TimeoutError):
                async with time_limit(LOOK_EVERY_S):
                    await self._has_asked.wait()
        gone: set[bytes] = self._node.forget_host()
        return gone

    def _go(self) -> None:
        if n := min(self._asked, self._let):
            self._asked -= n
            self._let -= n
            self._scheduler.step(n)

    def check(self, waited_s: float = 0.0) -> None:
        """NotInStep if the controller has ended, or has not called Step for too long."""
        if self._two:
            raise NotInStep(self._two)
        now_s = self._scheduler.tick * self._scheduler.base_period_ns * 1e-9
        if self._controller is not None and self._controller.has_ended:
            raise NotInStep(
                f"the controller {self._controller.ending}, at {now_s:g} s, while the test goes on"
            )
        if self.steps < 1 and self._writes_on():
            raise NotInStep(f"the controller commands and does not call Step; {REMEDY}")
        if waited_s <= self._patience_s:
            return
        if self.steps > 0:
            raise NotInStep(
                f"the controller has not called Step for {waited_s:.0f} s, at {now_s:g} s;"
                f" {REMEDY}"
            )
        if self.steps == 0 and self._node is not None:
            raise NotInStep(
                f"a node is there and has not called hilserver/step for {waited_s:.0f} s: time"
                f" stands at {now_s:g} s, where a timer on simulated time that is slower than a"
                f" step (20 ms) never fires; {REMEDY}"
            )
        raise NotInStep(
            f"no controller has called Step for {waited_s:.0f} s; does it"
            f" {_ARRIVES[self._door]}? {REMEDY}"
        )

    def _writes_on(self) -> bool:
        """Whether a controller has gone on writing for a while, as by a clock of its own."""
        age_s = self._gate.age_s(self._door)
        if age_s is not None and age_s < LOOK_EVERY_S:
            self._looks_with_news += 1
        return self._looks_with_news >= LOOKS_WITH_NEWS


def outsider(sessions: Iterable[Any]) -> str:
    """Return the address of a client that is another process, empty if there is none.

    A client in the test's own process writes while the test waits for it.
    """
    for session in sessions:
        try:
            host, port = session.processor.socket.getpeername()[:2]
        except (OSError, AttributeError):  # it has just left
            continue
        if (host, port) not in _own_addresses():
            return f"{host}:{port}"
    return ""


def _own_addresses() -> Iterator[tuple[str, int]]:
    """Yield the local addresses of all TCP sockets of this process."""
    for entry in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError, ValueError):
            if stat.S_ISSOCK(entry.stat().st_mode):
                with socket.socket(fileno=os.dup(int(entry.name))) as known:
                    if known.family in (socket.AF_INET, socket.AF_INET6):
                        yield known.getsockname()[:2]
