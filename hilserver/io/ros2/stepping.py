"""The service ``hilserver/step``: a robot in virtual time waits until its controller asks for it.

A step lasts until the next messages are due. They are written when its ticks have passed, then the
request is answered: a controller that asks once for each message sees every one of them, and the
robot moves while nobody computes.

The first step is made for a controller as soon as its client is there, so that it has something to
answer. Its messages are repeated until it does, as it may know the robot later than the robot it.
Who asks before that step is over has asked for the next one: so a controller that begins by asking
gets its first answer after two steps, however fast it is.
"""

from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final

from hilserver.core.control import Control
from hilserver.errors import ControlRefused
from hilserver.image import Frame, ProcessImage
from hilserver.io.ros2.parameters import NODE
from hilserver.ros.flavours import Served
from hilserver.ros.robot import RosFrame

TRIGGER: Final = "std_srvs/srv/Trigger"
STEP: Final = f"{NODE}/step"
PERIOD_S: Final = 0.02
"""Between two messages of the fastest topics."""
REPEATED_NS: Final = 500_000_000
_RUNS: Final = (
    "the robot runs by its own clock: only in a test with virtual time, inside"
    " 'async with hil.controller(...)', it waits for steps"
)


class Stepping:
    """Asks for steps, and knows when they are over.

    Parameters
    ----------
    tick_ns : int
        Period of a tick.
    """

    def __init__(self, control: Control, image: ProcessImage, tick_ns: int) -> None:
        self._control, self._image = control, image
        self._ticks = max(1, round(PERIOD_S * 1e9 / tick_ns))  # of a step
        self._answers: list[Callable[[bool], None]] = []
        self._last: int | None = None  # number of the last frame of a step
        self._writer = 0  # who has asked for it
        self._why = ""
        self._shown_ns: int | None = None  # when the messages of the first step came
        self._is_first = False  # the step that lasts

    def served(self) -> Served:
        """Return the service."""

        def serve(robot: RosFrame, _request: Any) -> Any:
            def response(is_done: bool) -> Any:
                said = "" if is_done else self._why
                return robot.make(f"{TRIGGER}_Response", success=is_done, message=said)

            return {}, response

        return Served(STEP, TRIGGER, serve)

    @property
    def stands(self) -> bool:
        """Whether time passes by steps only."""
        return self._control.stands

    def begin(self, now_ns: int, *, is_there: bool) -> bool:
        """Make the first step once its client `is_there`; return whether that was now."""
        if is_there and self.stands and self._shown_ns is None:
            self._shown_ns, self._is_first = now_ns, True
            # where another door steps as well, the test fails with that sentence
            with suppress(ControlRefused):
                self._step()
            return True
        return False

    def go_on(self) -> None:
        """Make the step that was asked for while the first one lasted."""
        if self._answers and self._last is None and self.stands:
            with suppress(ControlRefused):
                self._step()

    def repeats(self, now_ns: int) -> bool:
        """Whether the messages of the first step are due once more."""
        if self._shown_ns is None or self._writer or self._last is not None:
            return False
        if now_ns - self._shown_ns < REPEATED_NS:
            return False
        self._shown_ns = now_ns
        return True

    def ask(self, writer: int, answer: Callable[[bool], None]) -> None:
        """Ask for a step; `answer` is called when it is over, or at once if it is refused.

        Who asks again before that has asked for the same step; who asks during the first step, for
        the next one.
        """
        try:
            if not self.stands:
                raise ControlRefused(_RUNS)
            if self._last is None or self._writer not in (0, writer):
                self._step()
        except ControlRefused as error:
            self._why = str(error)
            answer(False)
            return
        self._writer = writer
        self._answers.append(answer)

    def _step(self) -> None:
        newest = self._image.latest()
        self._control.step(self._ticks)
        self._last = (-1 if newest is None else newest.number) + self._ticks

    def forget(self) -> None:
        """Begin anew with the next controller; nobody waits for an answer any more."""
        self._answers.clear()
        self._last = self._shown_ns = None
        self._writer, self._is_first = 0, False

    def is_over(self, frame: Frame) -> bool:
        """Whether the ticks that were asked for have passed."""
        return self._last is not None and frame.number >= self._last

    def end(self) -> None:
        """Answer who has asked for the step; nobody has asked for the first one."""
        self._last = None
        if self._is_first:
            self._is_first = False
            return
        answers, self._answers = self._answers, []
        for answer in answers:
            answer(True)
