"""The steps of a controller in ROS 2: whoever asks, and whenever, time passes the same."""

from types import SimpleNamespace

import pytest

from hilserver.io.ros2.stepping import Stepping
from hilserver.testing.lockstep import Lockstep, NotInStep

STEP, NODE, OTHER = 20, 7, 8
TICK_NS = 1_000_000


class Scheduler:
    """Ticks that pass at once."""

    tick = ticks_done = 0
    base_period_ns = TICK_NS

    def step(self, n):
        self.tick += n
        self.ticks_done += n


class Robot:
    """A robot in lockstep whose node is watched when a test says so."""

    def __init__(self):
        self.scheduler, self.log = Scheduler(), []
        gate = SimpleNamespace(age_s=lambda _: None)
        daemon = SimpleNamespace(
            scheduler=self.scheduler, gate=gate, part=lambda _: self
        )
        self.lockstep = Lockstep(daemon, None, 60.0, "ros2")
        control = SimpleNamespace(stands=True, step=self.lockstep.step)
        image = SimpleNamespace(latest=self.frame)
        self.stepping = Stepping(control, image, TICK_NS)

    def frame(self):
        done = self.scheduler.ticks_done
        return SimpleNamespace(number=done - 1) if done else None

    def asks(self, writer=NODE):
        self.stepping.begin(1, is_there=True)
        self.stepping.ask(writer, lambda ok: self.log.append((ok, self.passed)))

    def is_watched(self):
        self.stepping.begin(1, is_there=True)
        self.stepping.go_on()

    def passes(self, n):
        """Let `n` ticks pass for the test, if they are asked for."""
        self.lockstep._let = n
        self.lockstep._go()
        if (frame := self.frame()) and self.stepping.is_over(frame):
            self.stepping.end()

    @property
    def passed(self):
        return self.scheduler.ticks_done


@pytest.mark.parametrize("when", ["before", "during", "after"])
def test_who_asks_first_is_answered_after_the_same_time(when):
    robot = Robot()
    if when == "before":
        robot.asks()
    robot.is_watched()
    if when == "during":
        robot.asks()
    robot.passes(STEP)
    if when == "after":
        robot.asks()
    robot.is_watched()
    assert robot.log == []
    robot.passes(STEP)
    robot.is_watched()
    assert robot.log == [(True, 2 * STEP)]
    robot.passes(STEP)
    assert robot.passed == 2 * STEP
    robot.asks()
    robot.passes(STEP)
    assert robot.log == [(True, 2 * STEP), (True, 3 * STEP)]
    robot.lockstep.check()
    assert robot.lockstep.steps == 2


def test_a_second_controller_is_refused_in_the_first_step_too():
    robot = Robot()
    robot.is_watched()
    robot.asks()
    robot.asks(OTHER)
    assert robot.log == [(False, 0)]
    with pytest.raises(NotInStep, match="only one controller"):
        robot.lockstep.check()


def test_a_step_of_another_door_fails_the_test_and_not_the_watch():
    robot = Robot()
    robot.lockstep.step(STEP)
    robot.is_watched()
    with pytest.raises(NotInStep, match="only one controller"):
        robot.lockstep.check()


def test_a_node_that_is_there_and_never_asks_is_told_where_time_stands():
    robot = Robot()
    robot.is_watched()
    robot.passes(STEP)
    with pytest.raises(NotInStep, match=r"time stands at 0\.02 s.*slower than a step"):
        robot.lockstep.check(61.0)
