"""A host that falls silent, has no control, calls services, or shows the defects of drivers."""

import asyncio
import time
from contextlib import suppress

import numpy as np
import pytest

from hilserver.core.events import EventKind
from hilserver.errors import ControlRefused
from hilserver.ros.types import known_types
from hilserver.signals import State
from tests.io.ros2.rig import PATIENCE_S, SILENT_MS, Host, robot, speeds, twist, value
from tests.loopback.rig import wait_until

RPM = "iotbot_interface/msg/RotationSpeed"
DRIVE = ("w", "rt/iotbot/rpm", RPM, "reliable")
RETURN = ("r", "rt/iotbot/rpm/return", RPM, "reliable")
TWIST = ("w", "rt/cmd_vel", "geometry_msgs/msg/Twist", "reliable")
IMU = ("r", "rt/iotbot/imu", "sensor_msgs/msg/Imu", "best_effort")
JOY = ("w", "rt/joy", "sensor_msgs/msg/Joy", "reliable")
EXTENDED = ("w", "rt/joy_extended", "sensor_msgs/msg/Joy", "reliable")
ENABLE = "iotbot_interface/srv/SendEnable"
FORWARD = speeds(50, -50, 50, -50)
REFUSALS = 6
"""Of so many, a busy computer may really silence the host now and then."""


def request(name, type_name):
    """Endpoint of a service's requests; the type is the request's."""
    return ("w", f"rq/{name}Request", f"{type_name}_Request", "reliable")


def reply(name, type_name):
    return ("r", f"rr/{name}Reply", f"{type_name}_Response", "reliable")


async def drives(daemon, rpm=50.0):
    await wait_until(
        lambda: abs((value(daemon, "wheel.fl.speed_rpm") or 0.0) - rpm) < 1.0,
        PATIENCE_S,
    )


async def stands(daemon):
    await wait_until(lambda: abs(value(daemon, "wheel.fl.speed_rpm")) < 1.0, PATIENCE_S)


async def test_silence_withdraws_enable_until_the_host_enables_again(fast_dds, domain):
    service = "iotbot/srv/send_enable"
    call = f"rq/{service}Request"
    host = Host(
        fast_dds,
        domain,
        DRIVE,
        RETURN,
        request(service, ENABLE),
        reply(service, ENABLE),
    )
    async with robot(domain, stale_after_ms=SILENT_MS) as daemon, host:
        async with (
            host.repeating("rt/iotbot/rpm", **FORWARD),
            host.repeating(call, enable=True),
        ):
            await drives(daemon)
        await wait_until(lambda: value(daemon, "drive.enable") == 0.0, PATIENCE_S)
        again = "/iotbot/srv/send_enable enables the drive again"
        await wait_until(
            lambda: any(again in e.message for e in daemon.events.recent), 1.0
        )
        await stands(daemon)
        assert daemon.control.state is State.RUNNING, "the device stops, not the daemon"
        async with host.repeating("rt/iotbot/rpm", **FORWARD):
            await wait_until(
                lambda: value(daemon, "wheel.fl.setpoint_rpm") == 50.0, PATIENCE_S
            )
            assert value(daemon, "drive.enable") == 0.0
            async with host.repeating(call, enable=True):
                await drives(daemon)
            async with host.repeating(call, enable=False):
                await stands(daemon)
        assert host.last(f"rr/{service}Reply").sending_succesfull


async def test_ramp_is_the_safe_state_until_reset(fast_dds, domain):
    host = Host(fast_dds, domain, DRIVE)
    async with robot(domain, on_stale="ramp", stale_after_ms=SILENT_MS) as daemon, host:
        async with host.repeating("rt/iotbot/rpm", **FORWARD):
            await resets_until_it_drives(daemon)
        await wait_until(lambda: daemon.control.state is State.SAFE, PATIENCE_S)
        with pytest.raises(ControlRefused, match="ROS 2 host is silent"):
            daemon.control.reset()
        async with host.repeating("rt/iotbot/rpm", **FORWARD):
            await resets_until_it_drives(daemon)


async def resets_until_it_drives(daemon):
    """As often as a late host makes it necessary."""

    def drives_on():
        if daemon.control.state is State.SAFE:
            with suppress(ControlRefused):
                daemon.control.reset()
                daemon.control.start()
        return abs((value(daemon, "wheel.fl.speed_rpm") or 0.0) - 50.0) < 1.0

    await wait_until(drives_on, PATIENCE_S)


async def test_without_control_nothing_moves_and_silence_stops_nobody(fast_dds, domain):
    host = Host(fast_dds, domain, DRIVE)
    async with robot(domain, stale_after_ms=SILENT_MS) as daemon, host:
        daemon.gate.take("opcua")
        assert not daemon.gate.write(
            "opcua", {"wheels.setpoints_rpm": [10.0, 10.0, -10.0, -10.0]}
        )
        async with host.repeating("rt/iotbot/rpm", **FORWARD):
            rejected = lambda: daemon.gate.rejected["ros2", "not_in_control"] > 0  # noqa: E731
            await wait_until(rejected, PATIENCE_S)
            await drives(daemon, 10.0)
        await wait_until(lambda: daemon.part("ros2").status.stale, PATIENCE_S)
        assert value(daemon, "drive.enable") == 1.0
        assert value(daemon, "wheel.fl.setpoint_rpm") == 10.0


async def test_a_host_that_is_not_in_control_is_heard_all_the_same(fast_dds, domain):
    host = Host(fast_dds, domain, DRIVE)
    async with robot(domain, stale_after_ms=400) as daemon, host:
        daemon.gate.take("opcua")
        async with host.repeating("rt/iotbot/rpm", **FORWARD):
            heard = daemon.part("ros2").status.sequence_received + REFUSALS
            await wait_until(
                lambda: daemon.part("ros2").status.sequence_received > heard, PATIENCE_S
            )
            await asyncio.sleep(1.0)
            losses = [e for e in daemon.events.recent if e.kind is EventKind.PEER_LOST]
            assert not losses, "it sends all the time"


async def test_gamepad_drives_switches_lights_and_enables(fast_dds, domain):
    host = Host(fast_dds, domain, JOY, EXTENDED)
    make = known_types().make
    stamp = make("builtin_interfaces/msg/Time", sec=0, nanosec=0)
    header = make("std_msgs/msg/Header", stamp=stamp, frame_id="")

    def joy(forward=0.0, turn=0.0, throttle=1.0, pressed=()):
        axes, buttons = np.zeros(6, dtype=np.float32), np.zeros(12, dtype=np.int32)
        axes[1], axes[3], axes[5] = forward, turn, throttle
        for button in pressed:
            buttons[button] = 1
        return {"header": header, "axes": axes, "buttons": buttons}

    async with robot(domain) as daemon, host:
        fastest = daemon.assembly.robot.max_linear_m_s
        async with host.repeating(
            "rt/joy", **joy(forward=0.5, throttle=0.0, pressed=(4,))
        ):
            await wait_until(
                lambda: value(daemon, "twist.linear_m_s") == pytest.approx(fastest / 4),
                PATIENCE_S,
            )
            assert value(daemon, "lights.command") == 4.0
            assert value(daemon, "lights.green") == 0x88
        async with host.repeating("rt/joy_extended", **joy(forward=-1.0)):
            await wait_until(
                lambda: value(daemon, "twist.linear_m_s") == pytest.approx(-fastest),
                PATIENCE_S,
            )
            async with host.repeating("rt/joy", **joy(pressed=(10,))):
                await wait_until(
                    lambda: value(daemon, "drive.enable") == 1.0, PATIENCE_S
                )
            assert value(daemon, "twist.linear_m_s") == pytest.approx(-fastest), (
                "axes of joy rest"
            )


async def test_once_the_motion_node_drives_what_it_hears_moves_nothing_here(
    fast_dds, domain
):
    """The gamepad and cmd_vel reach both of us; only one of us may turn them into motion."""
    host = Host(fast_dds, domain, DRIVE, TWIST, JOY)
    make = known_types().make
    stamp = make("builtin_interfaces/msg/Time", sec=0, nanosec=0)
    header = make("std_msgs/msg/Header", stamp=stamp, frame_id="")
    axes, buttons = np.zeros(6, dtype=np.float32), np.zeros(12, dtype=np.int32)
    buttons[4] = 1
    joy = {"header": header, "axes": axes, "buttons": buttons}
    async with (
        robot(domain) as daemon,
        host,
        host.repeating("rt/cmd_vel", **twist(0.3)),
    ):
        await wait_until(lambda: value(daemon, "control.mode") == 1.0, PATIENCE_S)
        modes = set()
        async with (
            host.repeating("rt/iotbot/rpm", **FORWARD),
            host.repeating("rt/joy", **joy),
        ):
            await drives(daemon)
            ticks = value(daemon, "sim.tick") + 1000
            while value(daemon, "sim.tick") < ticks:
                modes.add(value(daemon, "control.mode"))
                await asyncio.sleep(0.002)
        assert modes == {0.0}
        assert value(daemon, "lights.command") == 4.0, "its buttons stay"
        told = [
            e.message for e in daemon.events.recent if "/iotbot/rpm drives" in e.message
        ]
        assert len(told) == 1
        assert "/cmd_vel, /joy_extended, /joy belong to the node" in told[0]


async def test_after_silence_a_command_enables_once_the_host_was_at_rest(
    fast_dds, domain
):
    host = Host(fast_dds, domain, DRIVE)
    ours = {"reenable": "command", "stale_after_ms": SILENT_MS}
    async with robot(domain, **ours) as daemon, host:
        async with host.repeating("rt/iotbot/rpm", **FORWARD):
            await drives(daemon)
        await wait_until(lambda: value(daemon, "drive.enable") == 0.0, PATIENCE_S)
        async with host.repeating("rt/iotbot/rpm", **FORWARD):
            await wait_until(
                lambda: value(daemon, "wheel.fl.setpoint_rpm") == 50.0, PATIENCE_S
            )
            assert value(daemon, "drive.enable") == 0.0, "it has not been at rest"
        async with host.repeating("rt/iotbot/rpm", **speeds()):
            await wait_until(lambda: value(daemon, "drive.enable") == 1.0, PATIENCE_S)
        async with host.repeating("rt/iotbot/rpm", **FORWARD):
            await drives(daemon)


# --- defects 1 to 5 of real drivers: the symptom with, none without -------------------------------


async def test_defect_1_turns_too_slowly(fast_dds, domain):
    host = Host(fast_dds, domain, TWIST)
    async with (
        robot(domain) as daemon,
        host,
        host.repeating("rt/cmd_vel", **twist(0.0, 0.5)),
    ):
        turning = lambda: value(daemon, "velocity.angular_rad_s") or 0.0  # noqa: E731
        await wait_until(lambda: abs(turning() - 0.5) < 0.05, PATIENCE_S)
        daemon.faults.inject({"fault": "shield.yaw_rate_without_60_2pi"})
        await wait_until(lambda: abs(turning() - 0.5 / 9.55) < 0.02, PATIENCE_S)
        daemon.faults.clear()
        await wait_until(lambda: abs(turning() - 0.5) < 0.05, PATIENCE_S)


async def test_defect_2_drives_on(fast_dds, domain):
    host = Host(fast_dds, domain, DRIVE)
    async with robot(domain, stale_after_ms=SILENT_MS) as daemon, host:
        daemon.faults.inject({"fault": "shield.dead_command_timeout"})
        async with host.repeating("rt/iotbot/rpm", **FORWARD):
            await drives(daemon)
        await wait_until(lambda: daemon.part("ros2").status.stale, PATIENCE_S)
        await wait_until(
            lambda: daemon.part("ros2").status.input_age_s(time.monotonic_ns()) > 2.5,
            PATIENCE_S,
        )
        assert value(daemon, "wheel.fl.speed_rpm") == pytest.approx(50.0, abs=1.0)
        daemon.faults.clear()
        await stands(daemon)


async def test_defect_3_scales_by_the_last_wheel(fast_dds, domain):
    host = Host(fast_dds, domain, TWIST)
    async with (
        robot(domain) as daemon,
        host,
        host.repeating("rt/cmd_vel", **twist(0.5, 0.6)),
    ):
        left = lambda: value(daemon, "wheel.fl.speed_rpm") or 0.0  # noqa: E731
        forward = lambda: value(daemon, "velocity.linear_m_s") or 0.0  # noqa: E731
        await wait_until(lambda: abs(forward() - 0.5) < 0.01, PATIENCE_S)
        before = left(), value(daemon, "wheel.fr.speed_rpm")
        limit = min(map(abs, before)) * 0.9
        daemon.faults.inject({"fault": "shield.last_wheel_scaling", "value": limit})
        await wait_until(lambda: abs(left()) < abs(before[0]) - 1.0, PATIENCE_S)
        after = [
            abs(value(daemon, f"wheel.{wheel}.speed_rpm")) for wheel in ("fl", "fr")
        ]
        assert max(after) > limit + 0.5, (
            "the fastest wheel is above the limit all the same"
        )


async def test_defect_4_swaps_the_front_wheels(fast_dds, domain):
    host = Host(fast_dds, domain, DRIVE, RETURN)
    driving = host.repeating("rt/iotbot/rpm", **speeds(40, -20, 40, -20))
    async with robot(domain) as daemon, host, driving:
        await host.sees(RETURN[1], lambda m: m.front_left_rpm > 39)
        daemon.faults.inject({"fault": "shield.front_wheels_swapped"})
        seen = await host.sees(RETURN[1], lambda m: m.front_right_rpm > 39)
        assert seen.front_left_rpm == pytest.approx(-20, abs=1)
        daemon.faults.clear()
        await host.sees(RETURN[1], lambda m: m.front_left_rpm > 39)


async def test_defect_5_reads_unsigned_and_in_g(fast_dds, domain):
    host = Host(fast_dds, domain, DRIVE, RETURN, IMU)
    driving = host.repeating("rt/iotbot/rpm", **speeds(-40, -40, -40, -40))
    async with robot(domain) as daemon, host, driving:
        await host.sees(RETURN[1], lambda m: m.front_left_rpm < -39)
        turning = (await host.sees(IMU[1])).angular_velocity.z
        assert 0.2 < abs(turning) < 10.0
        daemon.faults.inject({"fault": "shield.rpm_unsigned"})
        await host.sees(RETURN[1], lambda m: m.front_left_rpm > 600)
        daemon.faults.inject({"fault": "shield.imu_raw_units"})
        await host.sees(IMU[1], lambda m: abs(m.angular_velocity.z) > 20 * abs(turning))
        daemon.faults.clear()
        await host.sees(RETURN[1], lambda m: m.front_left_rpm < -39)
        await host.sees(IMU[1], lambda m: abs(m.angular_velocity.z) < 10.0)
