import uuid

import pytest

from hilserver.core.deadman import DeadMan
from hilserver.core.events import EventBus
from hilserver.core.inputs import InputGate
from hilserver.image import ProcessImage
from hilserver.signals import Ranges, robot_table


class Timers:
    """The event loop's timers, by hand."""

    def __init__(self):
        self.now_s, self.waiting = 0.0, []

    def call_later(self, delay_s, callback, source):
        timer = Timer(self.now_s + delay_s, callback, source)
        self.waiting.append(timer)
        return timer

    def pass_s(self, seconds):
        self.now_s += seconds
        for timer in [t for t in self.waiting if t.due_s <= self.now_s + 1e-9 and not t.is_over]:
            timer.is_over = True
            timer.callback(timer.source)


class Timer:
    def __init__(self, due_s, callback, source):
        self.due_s, self.callback, self.source, self.is_over = due_s, callback, source, False

    def cancel(self):
        self.is_over = True


class Rig:
    def __init__(self):
        table = robot_table(Ranges(90.0, 0.8, 3.0))
        self.image = ProcessImage(
            f"deadman-{uuid.uuid4().hex[:8]}", table, live={}, fixed={}, base_period_ns=1_000_000
        )
        self.events, self.timers = EventBus(), Timers()
        self.gate = InputGate(table, self.image, self.events, owner="page")
        self.deadman = DeadMan(self.gate, self.events, 0.3, self.timers.call_later)

    def drive(self, source="page:1", speed=0.4):
        assert not self.gate.write(source, {"control.mode": 1, "twist.linear_m_s": speed})

    @property
    def speed(self):
        return self.gate.newest("twist.linear_m_s") or 0.0


@pytest.fixture
def rig():
    rig = Rig()
    yield rig
    rig.image.close()


def test_a_held_command_lives_as_long_as_it_is_renewed(rig):
    for _ in range(20):
        rig.drive()
        rig.timers.pass_s(0.29)
        assert rig.speed == 0.4
    rig.timers.pass_s(0.01)
    assert rig.speed == 0.0
    assert "no fresh command for 300 ms" in rig.events.recent[-1].message


def test_another_browser_does_not_keep_it_alive(rig):
    rig.drive("page:1")
    rig.timers.pass_s(0.2)
    assert not rig.gate.write("page:2", {"lights.command": 1})
    rig.timers.pass_s(0.1)
    assert rig.speed == 0.0


def test_zero_is_not_held(rig):
    rig.drive()
    rig.drive(speed=0.0)
    rig.timers.pass_s(1.0)
    assert not rig.events.recent


def test_what_the_page_left_ends_although_another_source_has_control(rig):
    rig.drive()
    rig.gate.take("opcua")
    rig.timers.pass_s(0.3)
    assert rig.speed == 0.0


def test_a_source_that_has_taken_over_and_writes_is_left_alone(rig):
    rig.drive()
    rig.gate.take("opcua")
    assert not rig.gate.write("opcua", {"twist.linear_m_s": 0.2})
    rig.timers.pass_s(1.0)
    assert rig.speed == 0.2
