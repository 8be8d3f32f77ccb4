"""Does the robot do what my controller needs it to do?"""

import math

import pytest
from controller import HeadingController

pytestmark = pytest.mark.hil(config="robot.yaml")
CYCLE_TICKS = 20


@pytest.mark.requirement("HIL-1")
async def test_it_turns_to_a_heading_in_time(hil):
    controller = HeadingController(target_rad=math.pi / 2)
    async with hil.capture("pose.yaw_rad") as trace:
        for _ in range(200):
            hil.write(controller.cycle(hil.read("pose.yaw_rad")))
            yield CYCLE_TICKS
    trace["pose.yaw_rad"].assert_settles(math.pi / 2, math.radians(3), within_s=3.0)
    trace["pose.yaw_rad"].assert_overshoot(math.pi / 2, at_most=0.1)


@pytest.mark.requirement("HIL-2")
async def test_the_robot_stops_when_the_controller_falls_silent(hil):
    drive = {"control.mode": 1, "twist.linear_m_s": 0.3, "twist.angular_rad_s": 0.0}
    for _ in range(50):
        hil.write(drive)
        yield CYCLE_TICKS
    assert hil.read("velocity.linear_m_s") == pytest.approx(0.3, abs=0.02)
    # From here on nobody commands. The shield promises to stop 0.5 s after the last command.
    async with hil.capture("velocity.linear_m_s") as trace:
        yield 1500
    trace["velocity.linear_m_s"].assert_settles(0.0, 0.01, within_s=1.0)
