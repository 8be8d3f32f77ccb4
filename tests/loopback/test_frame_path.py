"""One set-point from the wire to the wheel and back, and which way the robot then turns."""

import asyncio
import math
import time
from datetime import UTC, datetime

import pytest
import pytest_asyncio
from asyncua import ua

from hilserver.plant.layout import WHEELS
from tests.loopback.rig import call, configuration, double, frames, run_ticks, running

pytestmark = pytest.mark.asyncio(loop_scope="module")


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def robot():
    async with running(configuration()) as pair:
        yield pair


@pytest_asyncio.fixture(loop_scope="module")
async def at_rest(robot):
    """The robot at the origin at tick 0, standing still."""
    daemon, client = robot
    assert await call(client, "Reset") == "Good"
    await run_ticks(daemon, 40)
    return daemon, client


async def drive(client, fl, rl, fr, rr):
    names = [f"wheel__{wheel}__setpoint_rpm" for wheel in WHEELS]
    codes = await client.write_doubles(
        **dict(zip(names, (fl, rl, fr, rr), strict=True))
    )
    assert codes == ["Good"] * 4


async def test_a_set_point_reaches_the_wheel_and_comes_back(at_rest):
    daemon, client = at_rest
    slot = daemon.table.slot
    first = daemon.image.head - 10
    await drive(client, 30.0, 30.0, -30.0, -30.0)
    assert await client.read("wheel.fl.setpoint_rpm") == 30.0
    await run_ticks(daemon, 400)
    history = list(frames(daemon, first))
    latched = [f.values[slot("wheel.fl.setpoint_rpm")] for f in history]
    assert latched[0] == 0.0
    begin = latched.index(30.0)
    assert set(latched[begin:]) == {30.0}
    assert [history[begin].values[slot(f"wheel.{w}.setpoint_rpm")] for w in WHEELS] == [
        30.0,
        30.0,
        -30.0,
        -30.0,
    ], "one request is latched by one tick"
    speeds = [f.values[slot("wheel.fl.speed_rpm")] for f in history]
    assert set(speeds[: begin + 1]) == {0.0}, "the wheel moves after the set-point"
    assert speeds[begin + 1] > 0.0
    assert speeds[-1] == pytest.approx(30.0, abs=0.5)
    mirrored = [f.values[slot("wheel.fr.speed_rpm")] for f in history]
    assert mirrored == [-v for v in speeds], "forward is negative on the right"
    assert await client.read("wheels.speeds_rpm") == pytest.approx(
        [30, 30, -30, -30], abs=0.5
    )


async def test_the_stamp_is_the_tick_that_made_the_value(at_rest):
    daemon, client = at_rest
    await drive(client, 20.0, 20.0, -20.0, -20.0)
    await run_ticks(daemon, 100)
    data = await client.data_value("pose.x_m")
    slot = daemon.table.slot("pose.x_m")
    made_by = [f for f in frames(daemon) if f.values[slot] == data.Value.Value]
    assert len(made_by) == 1, "every tick of a moving robot has its own position"
    age_s = (time.monotonic_ns() - made_by[0].planned_ns) * 1e-9
    expected = datetime.now(UTC).timestamp() - age_s
    assert data.SourceTimestamp.timestamp() == pytest.approx(expected, abs=0.005)
    later = await client.data_value("pose.x_m")
    assert data.StatusCode.name == "Good"
    assert later.SourceTimestamp >= data.SourceTimestamp


async def test_left_forward_right_backward_decreases_yaw(at_rest):
    daemon, client = at_rest
    await drive(client, 20.0, 20.0, 20.0, 20.0)
    await run_ticks(daemon, 300)
    assert await client.read("pose.yaw_rad") < -0.05
    assert await client.read("velocity.angular_rad_s") < -0.1
    assert abs(await client.read("pose.x_m")) < 0.02, "on the spot"


async def test_a_positive_twist_turns_left(at_rest):
    daemon, client = at_rest
    codes = await client.write(
        ("control.mode", 1, ua.VariantType.Byte),
        ("twist.angular_rad_s", 0.5, ua.VariantType.Double),
    )
    assert codes == ["Good", "Good"]
    await run_ticks(daemon, 500)
    assert await client.read("velocity.angular_rad_s") == pytest.approx(0.5, abs=0.01)
    assert 0.05 < await client.read("pose.yaw_rad") < math.pi


async def test_set_pose_puts_the_robot_there(at_rest):
    daemon, client = at_rest
    assert (
        await call(client, "SetPose", double(1.5), double(-2.0), double(0.75)) == "Good"
    )
    await run_ticks(daemon, 60)
    await asyncio.sleep(0.05)
    pose = [await client.read(f"pose.{name}") for name in ("x_m", "y_m", "yaw_rad")]
    assert pose == [1.5, -2.0, 0.75]
    result = await client.call("SetPose", double(1e9), double(0.0), double(0.0))
    assert result.StatusCode.name == "BadInvalidArgument"
    assert await client.read("pose.x_m") == 1.5
