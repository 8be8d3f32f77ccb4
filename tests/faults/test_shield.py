"""The robot stack's own defects, each with the healthy shield beside it."""

import math

import numpy as np
import pytest

from hilserver.plant.layout import LEFT_WHEELS, RIGHT_WHEELS
from tests.faults.rig import Rig

MODE = {"control__mode": 1}


async def drive(*faults, ticks=1500, silence_ticks=0, **values):
    async with Rig(silence_ticks=silence_ticks) as rig:
        rig.faults.inject(*({"fault": f} if isinstance(f, str) else f for f in faults))
        rig.write(**values)
        await rig.advance(ticks)
        rows = np.array([frame.values for frame in rig.frames()])
        return {s.name: rows[:, s.slots[0]] for s in rig.table if not s.is_array}


async def test_1_yaw_rate_without_60_2pi_turns_9_5_times_too_slow():
    healthy = await drive(twist__angular_rad_s=1.0, **MODE)
    broken = await drive(
        "shield.yaw_rate_without_60_2pi", twist__angular_rad_s=1.0, **MODE
    )
    ratio = healthy["velocity.angular_rad_s"][-1] / broken["velocity.angular_rad_s"][-1]
    assert ratio == pytest.approx(60 / (2 * math.pi), rel=0.02)


async def test_2_dead_command_timeout_drives_on():
    settings = {"ticks": 2000, "silence_ticks": 500}
    wheels = {f"wheel__{w}__setpoint_rpm": s * 30 for w, s in FORWARD.items()}
    healthy = await drive(**settings, **wheels)
    broken = await drive("shield.dead_command_timeout", **settings, **wheels)
    assert healthy["wheel.fl.setpoint_rpm"][500] == 30
    assert healthy["wheel.fl.setpoint_rpm"][502] == 0
    assert abs(healthy["wheel.fl.speed_rpm"][-1]) < 1
    assert broken["wheel.fl.speed_rpm"][-1] == pytest.approx(30, abs=1)


FORWARD = dict.fromkeys(LEFT_WHEELS, 1) | dict.fromkeys(RIGHT_WHEELS, -1)


async def test_2_a_command_in_time_keeps_the_robot_going():
    async with Rig(silence_ticks=100) as rig:
        for _ in range(10):
            rig.write(wheel__fl__setpoint_rpm=30)
            await rig.advance(90)
        assert rig.series("wheel.fl.setpoint_rpm")[-1] == 30
        assert rig.mailbox.timeouts == 0
        await rig.advance(200)
        assert rig.series("wheel.fl.setpoint_rpm")[-1] == 0
        assert rig.mailbox.timeouts == 1
        assert rig.mailbox.is_silent


LAST_WHEEL = {"fault": "shield.last_wheel_scaling", "value": 50.0}


async def test_3_last_wheel_scaling_bends_the_path():
    """Both sides too fast for the driver: the right's factor leaves the left to be cut off."""
    values = {"twist__linear_m_s": -0.75, "twist__angular_rad_s": 0.6}
    healthy = await drive(**values, **MODE)
    broken = await drive(LAST_WHEEL, **values, **MODE)

    def curvature(run):
        return run["velocity.angular_rad_s"][-1] / run["velocity.linear_m_s"][-1]

    assert abs(broken["wheel.fl.speed_rpm"][-1]) == pytest.approx(50, abs=1)
    assert curvature(broken) != pytest.approx(curvature(healthy), rel=0.02)
    slow = {"twist__linear_m_s": 0.2, "twist__angular_rad_s": 0.2}
    same = await drive(LAST_WHEEL, **slow, **MODE)
    assert curvature(same) == pytest.approx(
        curvature(await drive(**slow, **MODE)), rel=1e-6
    )


async def test_4_front_wheels_change_places():
    wheels = {"wheel__fl__setpoint_rpm": 20, "wheel__fr__setpoint_rpm": -50}
    run = await drive("shield.front_wheels_swapped", **wheels)
    assert run["wheel.fr.speed_rpm"][-1] == pytest.approx(20, abs=1)
    assert run["wheel.fl.speed_rpm"][-1] == pytest.approx(-50, abs=1)


async def test_5_unsigned_rpm_wraps_below_zero():
    wheels = {"wheel__fl__setpoint_rpm": 20, "wheel__fr__setpoint_rpm": -20}
    run = await drive("shield.rpm_unsigned", **wheels)
    assert run["wheel.fl.speed_rpm"][-1] == pytest.approx(20, abs=1)
    assert run["wheel.fr.speed_rpm"][-1] == pytest.approx(655.36 - 20, abs=1)


async def test_5_imu_in_g_and_degrees():
    values = {"twist__angular_rad_s": 1.0, "twist__linear_m_s": 0.3}
    healthy = await drive(**values, **MODE)
    broken = await drive("shield.imu_raw_units", **values, **MODE)
    assert np.allclose(
        broken["imu.gyro_z_rad_s"], np.degrees(healthy["imu.gyro_z_rad_s"])
    )
    assert np.allclose(
        broken["imu.accel_y_m_s2"] * 9.80665, healthy["imu.accel_y_m_s2"]
    )
