"""Against Fast DDS and Cyclone DDS as ROS 2 configures them: every topic, both ways."""

import math

import pytest

from hilserver.ros.flavours import FLAVOURS
from hilserver.ros.measured import IOTBOT, MEASURED_TYPES
from hilserver.ros.types import known_types
from hilserver.signals import State
from tests.io.ros2.rig import PATIENCE_S, Host, four_floats, robot, speeds, twist, value
from tests.loopback.rig import wait_until
from tests.ros import messages as real

RPM = "iotbot_interface/msg/RotationSpeed"
EXTRAS = {"tf": True, "clock": True, "odom": True, "pose_stamped": True}


def endpoints(flavour, space=""):
    """Every topic of a flavour, as the host has it."""
    known = FLAVOURS[flavour]
    absolute = {p.topic: p for p in (*known.published, *known.extras.values())}
    for published in absolute.values():
        name = (
            published.topic
            if published.topic[0] == "/"
            else f"{space}/{published.topic}"
        )
        reliability = "reliable" if published.qos.reliable else "best_effort"
        yield "r", f"rt{name}", published.type, reliability
    for subscribed in known.subscribed:
        yield "w", f"rt{space}/{subscribed.topic}", subscribed.type, "reliable"


async def test_a_host_drives_by_rpm_and_reads_every_topic(peer, domain):
    host = Host(peer, domain, *endpoints("iotbot_shield"))
    driving = host.repeating("rt/iotbot/rpm", **speeds(40, -30, 40, -30))
    published = EXTRAS | {"robot_description": True}
    async with robot(domain, publish=published) as daemon, host, driving:
        seen = await host.sees(
            "rt/iotbot/rpm/return", lambda m: m.front_left_rpm > 39.5
        )
        assert seen.front_right_rpm == pytest.approx(-30, abs=1)
        for topic in set(host.received) - {
            "rt/iotbot/odometry/filtered",
            "rt/odometry/filtered",
        }:
            await host.sees(topic)
        imu = host.last("rt/iotbot/imu")
        assert imu.header.frame_id == "imu_link"
        assert imu.linear_acceleration.z == pytest.approx(9.80665)
        assert len(host.last("rt/iotbot/tof").data) == 4
        assert host.last("rt/iotbot/battery").voltage > 10
        transform = host.last("rt/tf").transforms[0]
        assert (transform.header.frame_id, transform.child_frame_id) == (
            "odom",
            "base_link",
        )
        assert daemon.gate.owner == "ros2"
        status = daemon.part("ros2").status
        await wait_until(lambda: status.connected and not status.stale, PATIENCE_S)
        assert status.interval.last_ns is not None
        assert status.one_way.last_ns is not None
        assert daemon.gate.age_s("ros2") < PATIENCE_S


STAMPS = {
    "rt/clock": lambda m: m.clock,
    "rt/odom": lambda m: m.header.stamp,
    "rt/tf": lambda m: m.transforms[0].header.stamp,
    "rt/poseStamped": lambda m: m.header.stamp,
}


@pytest.mark.parametrize(
    "minutes",
    [
        pytest.param(1, id="as_many_messages_as_a_topic_has_in_a_minute"),
        pytest.param(40, id="four_topics_for_ten_minutes", marks=pytest.mark.long),
    ],
)
@pytest.mark.timeout(1200)
async def test_reliable_topics_lose_nothing(fast_dds, domain, minutes):
    """All four bear the same time stamps, from the first to the last that all have."""
    count = minutes * 3000
    host = Host(
        fast_dds, domain, *(e for e in endpoints("iotbot_shield") if e[1] in STAMPS)
    )
    async with robot(domain, publish=EXTRAS) as daemon, host:
        enough = lambda: sum(map(len, host.received.values())) > count  # noqa: E731
        await wait_until(enough, PATIENCE_S + 20 * minutes)
        counts = daemon.part("ros2").status.fault_counts.copy()
    seen = [
        [nanoseconds(of(m)) for m in host.messages(topic)]
        for topic, of in STAMPS.items()
    ]
    first, last = max(times[0] for times in seen), min(times[-1] for times in seen)
    clock, *others = ([t for t in times if first <= t <= last] for times in seen)
    assert len(clock) > count / 5
    assert clock == sorted(clock)
    assert others == [clock] * 3
    assert counts["not_taken"] == 0


def nanoseconds(stamp):
    return stamp.sec * 10**9 + stamp.nanosec


async def test_every_topic_of_a_real_iot_bot_is_measured(fast_dds, domain):
    """Also those types for which PyPI has no `rclpy` package."""
    kinds = {
        name if name[0] == "/" else f"/{name}": kind for name, kind in IOTBOT.items()
    }
    types = {f"rt{name}": MEASURED_TYPES[kind].type for name, kind in kinds.items()}
    host = Host(
        fast_dds,
        domain,
        *(("w", topic, kind, "reliable") for topic, kind in types.items()),
    )
    link = ("odom", "base_link", 1.5, 0.0, 0.0)
    messages = {
        "rt/iotbot/rpm/return": known_types().make(RPM, **speeds(10, -20, 30, -40)),
        "rt/iotbot/imu": real.imu(),
        "rt/iotbot/battery": known_types().make(
            "iotbot_interface/msg/Battery", voltage=11.5
        ),
        "rt/poseStamped": real.tagged(0.5, 0.6, 0.7, "odom"),
        "rt/odom": real.odometry("odom", x=1.5),
        "rt/joint_states": real.joints(
            front_left=9.0, front_right=9.0, rear_left=9.0, rear_right=9.0
        ),
        "rt/tf": real.transforms(link),
    }
    measured = {"frame": "odom"}
    async with robot(domain, namespace="/sim", measured=measured) as daemon, host:
        expected = {
            "wheel.rr.speed_rpm": -40.0,
            "imu.gyro_z_rad_s": 0.2,
            "nav.yaw_rad": 0.7,
        }
        expected |= {
            "battery.voltage_v": 11.5,
            "velocity.lateral_m_s": 0.1,
            "pose.x_m": 1.5,
        }

        def have_come():
            for topic, message in messages.items():
                host.write_cdr(topic, known_types().encode(message))
            return all(near(daemon, f"measured.{n}", v)() for n, v in expected.items())

        await wait_until(have_come, PATIENCE_S)
        part = daemon.parts_of("ros2")[1]
        heard = lambda: all(topic.has_values for topic in part._topics)  # noqa: E731
        await wait_until(lambda: have_come() and heard(), PATIENCE_S)
        assert not set(+part.status.fault_counts) - {"stamp"}, (
            "that of /tf is from 1970"
        )
        assert value(daemon, "measured.wheel.fl.speed_rpm") == 10.0, (
            "rpm/return was heard first"
        )


async def test_twist_beyond_what_the_robot_can(fast_dds, domain):
    host = Host(fast_dds, domain, *endpoints("iotbot_shield"))
    async with robot(domain) as daemon, host:
        async with host.repeating("rt/cmd_vel", **twist(0.2, 0.3)):
            for name, wanted in (
                ("velocity.linear_m_s", 0.2),
                ("velocity.angular_rad_s", 0.3),
            ):
                await wait_until(near(daemon, name, wanted), PATIENCE_S)
        async with host.repeating("rt/cmd_vel", **twist(50.0, 0.0)):
            fastest = daemon.assembly.robot.max_linear_m_s
            await wait_until(
                lambda: value(daemon, "twist.linear_m_s") == pytest.approx(fastest),
                PATIENCE_S,
            )


def near(daemon, name, wanted):
    return lambda: abs((value(daemon, name) or 0.0) - wanted) < 0.01


async def test_what_is_no_command_is_a_fault_and_nothing_else(fast_dds, domain):
    host = Host(fast_dds, domain, *endpoints("thesis_sil"))
    async with robot(domain, flavour="thesis_sil") as daemon, host:
        await host.sees("rt/rpm/return")
        counts = daemon.part("ros2").status.fault_counts

        def all_are_counted():
            """Write until it arrives: a reader of what may be lost takes no message for granted."""
            for cdr in (b"\0\1\0\0", b"\0\1\0\0" + bytes(7)):  # DDS itself drops them
                host.write_cdr("rt/rpm", cdr)
            for numbers in ([1, 2, 3], [math.nan, 0, 0, 0], [1e9, 0, 0, 0]):
                host.write("rt/rpm", **four_floats(*numbers))
            return counts["refused_value"] >= 2 and counts["bad_message"] >= 1

        await wait_until(all_are_counted, PATIENCE_S)
        assert set(+counts) == {"refused_value", "bad_message"}
        assert any(
            "3 numbers" in sentence
            for sentence in daemon.part("ros2").status.faults.values()
        )
        assert daemon.part("ros2").status.stale, "nothing usable has come"
        assert daemon.control.state is State.RUNNING
        assert value(daemon, "wheel.fl.setpoint_rpm") == 0.0


NOT_ASKED_FOR = {
    "rt/tf",
    "rt/clock",
    "rt/poseStamped",
    "rt/eduard/odom",
    "rt/eduard/odometry/filtered",
}


async def test_edu_robot(peer, domain):
    host = Host(peer, domain, *endpoints("eduard", "/eduard"))
    async with robot(domain, flavour="eduard") as daemon, host:
        async with host.repeating("rt/eduard/cmd_vel", **twist(0.2)):
            seen = await host.sees(
                "rt/eduard/odometry", lambda m: m.twist.twist.linear.x > 0.19
            )
            assert seen.header.frame_id == "eduard/odom"
            for topic in set(host.received) - NOT_ASKED_FOR:
                if (
                    "kinematic" not in topic
                ):  # a latched one, for a reader that asks for no past
                    await host.sees(topic)
            # edu_robot's signs: right forward, left backward
            forward = lambda m: m.rpm[0] > 0 > m.rpm[3]  # noqa: E731
            report = await host.sees("rt/eduard/status_report", forward)
            assert report.robot_state.mode.mode == 2
            joints = "rt/eduard/joint_states"
            await wait_until(lambda: len(host.received[joints]) >= 8, PATIENCE_S)
            assert len({m.name[0] for m in host.messages(joints)}) == 4
        assert daemon.part("ros2").status.fault_counts.total() == 0


async def test_a_base_of_ros2_control(fast_dds, domain):
    written = {t.topic.strip("/"): t.type for t in FLAVOURS["diff_drive"].published}
    topics = ("odom", "tf", "joint_states")
    heard = [("r", f"rt/{name}", written[name], "reliable") for name in topics]
    stamped = "geometry_msgs/msg/TwistStamped"
    host = Host(fast_dds, domain, *heard, ("w", "rt/cmd_vel", stamped, "reliable"))
    make = known_types().make
    time = make("builtin_interfaces/msg/Time", sec=0, nanosec=0)
    header = make("std_msgs/msg/Header", stamp=time, frame_id="base_link")
    drive = make("geometry_msgs/msg/Twist", **twist(0.2))
    async with robot(domain, flavour="diff_drive") as daemon, host:
        async with host.repeating("rt/cmd_vel", header=header, twist=drive):
            seen = await host.sees("rt/odom", lambda m: m.twist.twist.linear.x > 0.19)
            assert (seen.header.frame_id, seen.child_frame_id) == ("odom", "base_link")
            (place,) = (await host.sees("rt/tf")).transforms
            assert (place.header.frame_id, place.child_frame_id) == (
                "odom",
                "base_link",
            )
            assert len((await host.sees("rt/joint_states")).name) == 4
        assert daemon.part("ros2").status.fault_counts.total() == 0


async def test_the_five_topics_of_the_thesis(peer, domain):
    host = Host(peer, domain, *endpoints("thesis_sil"))
    driving = host.repeating("rt/rpm", **four_floats(10, 20, -30, -40))
    async with robot(domain, flavour="thesis_sil") as daemon, host, driving:
        asked = [10, 20, -30, -40]
        await host.sees("rt/rpm/return", lambda m: [round(x) for x in m.data] == asked)
        assert value(daemon, "wheel.rl.setpoint_rpm") == 20.0
        place = await host.sees("rt/position_and_orientation")
        assert len(place.data) == 6
        assert math.isnan(place.data[5]), "no mechatronic model is running"
        assert len((await host.sees("rt/distance_measurements")).data) == 4
        async with host.repeating("rt/lights_color", data=0x46):
            await wait_until(lambda: value(daemon, "lights.command") == 4, PATIENCE_S)
