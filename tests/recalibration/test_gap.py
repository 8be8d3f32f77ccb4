"""The watch over the gap: which of a frame's signals count, and when the robot moves."""

from types import SimpleNamespace

import numpy as np
import pytest

from hilserver.core.events import EventBus
from hilserver.image import Frame
from hilserver.recalibration.gap import DRIVEN_RPM, ChangeWatch
from hilserver.status import UNCERTAIN_LAST_USABLE_VALUE
from tests.fakes import make_gate, make_image, make_table

SPEED, SETPOINT, GYRO = (
    "wheel.fl.speed_rpm",
    "wheel.fl.setpoint_rpm",
    "imu.gyro_z_rad_s",
)
GROWS_S, END_S = 300, 500
TABLE = make_table()


@pytest.fixture
def watch():
    """A watch of a robot that measures a speed, a set-point and a turn rate."""
    image = make_image(TABLE)
    gate = make_gate(TABLE, image, EventBus())
    names = (SPEED, SETPOINT, GYRO)
    assert gate.write("peer:robot", {f"measured.{name}": 0.0 for name in names}) == {}
    yield ChangeWatch(SimpleNamespace(table=TABLE, gate=gate))
    image.close()


def found(watch, grows, *, bad=(), speed_rpm=40.0, seconds=range(END_S)):
    """Take a frame per second, in which the gap of one signal grows; return what was found."""
    rng, channels = np.random.default_rng(1), {}
    status = np.zeros(TABLE.n_slots, dtype=np.int64)
    for name in bad:
        status[TABLE.slot(name)] = UNCERTAIN_LAST_USABLE_VALUE
    for t_s in seconds:
        values = np.zeros(TABLE.n_slots)
        values[TABLE.slot("sim.time_s")] = t_s
        values[TABLE.slot(SPEED)] = speed_rpm
        for name in (SPEED, SETPOINT, GYRO):
            gap = rng.standard_normal() + (
                10.0 if name == grows and t_s >= GROWS_S else 0.0
            )
            values[TABLE.slot(f"measured.{name}")] = values[TABLE.slot(name)] + gap
        channel = watch.take(Frame(t_s, t_s, 0, 0, values, status))
        if channel is not None:
            channels.setdefault(channel, t_s)
    return channels


@pytest.mark.parametrize("name", [SPEED, GYRO])
def test_a_gap_that_grows_is_found_by_its_name(watch, name):
    channels = found(watch, name)
    assert list(channels) == [name]
    assert GROWS_S < channels[name] < END_S


def test_as_usual_is_no_change(watch):
    assert found(watch, None) == {}


@pytest.mark.parametrize("bad", [f"measured.{SPEED}", SPEED])
def test_what_is_not_good_at_either_side_is_left_out(watch, bad):
    assert found(watch, SPEED, bad=[bad]) == {}


def test_a_set_point_is_no_result_of_the_model(watch):
    assert found(watch, SETPOINT) == {}


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_only_a_robot_that_moves_counts(watch, sign):
    assert found(watch, SPEED, speed_rpm=sign * DRIVEN_RPM) == {}
    assert SPEED in found(watch, SPEED, speed_rpm=sign * (DRIVEN_RPM + 0.1))


def test_after_a_restart_the_larger_gap_is_usual(watch):
    found(watch, None, seconds=range(GROWS_S))
    watch.restart()
    assert found(watch, SPEED, seconds=range(GROWS_S, END_S)) == {}
