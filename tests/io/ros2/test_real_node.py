"""Real ROS 2 nodes (`rclpy`, rmw_fastrtps) and the daemon: they find each other and exchange."""

import asyncio
import sys
from contextlib import asynccontextmanager, suppress

import pytest

from hilserver.core.events import EventKind
from hilserver.errors import ControlRefused
from hilserver.io.ros2.status import CommandState
from hilserver.signals import State
from tests.io.ros2.rig import PATIENCE_S, robot, value
from tests.io.ros2.ros_node import ROOT, RosNode, needs_rclpy
from tests.loopback.rig import scrape, wait_until
from tests.node_red.black_hole import peer_network, run

pytestmark = needs_rclpy

TWIST = "geometry_msgs/msg/Twist"
DRIVE = {"linear": {"x": 0.2}, "angular": {"z": 0.5}}
SENSORS = {
    "/iotbot/imu": "sensor_msgs/msg/Imu",
    "/iotbot/tof": "std_msgs/msg/Float32MultiArray",
    "/iotbot/temperature": "std_msgs/msg/Float32",
}


FLOATS = "std_msgs/msg/Float32MultiArray"
GONE_S = 30.0
"""ROS 2 counts a participant that was killed as alive for 20 s."""


async def test_a_real_node_drives_and_reads_the_sensors(domain):
    node = RosNode(domain, {"/cmd_vel": TWIST}, SENSORS)
    async with robot(domain) as daemon, node:
        await node.is_ready()
        node.publish("/cmd_vel", times=500, **DRIVE)
        turns = lambda imu: imu["angular_velocity"]["z"] > 0.45  # noqa: E731
        imu = await node.sees("/iotbot/imu", turns)
        assert imu["header"]["frame_id"] == "imu_link"
        assert len((await node.sees("/iotbot/tof"))["data"]) == 4
        await node.sees("/iotbot/temperature")
        assert daemon.part("ros2").status.fault_counts.total() == 0
        node.process.kill()


TURTLEBOT = {
    "wheel_radius_m": 0.033,
    "wheelbase_m": None,
    "track_m": 0.16,
    "icr_offset_m": 0.0,
    "max_rpm": 65,
}


@pytest.mark.parametrize("kind", ["Twist", "TwistStamped"])
async def test_a_base_on_one_axle_is_driven_as_by_diff_drive_controller(domain, kind):
    """Nodes of ROS 2 up to Jazzy write a Twist, later ones a TwistStamped, to the same topic."""
    drive = {"linear": {"x": 0.1}, "angular": {"z": -0.5}}
    fields = drive if kind == "Twist" else {"twist": drive}
    node = RosNode(
        domain,
        {"/cmd_vel": f"geometry_msgs/msg/{kind}"},
        {"/joint_states": "sensor_msgs/msg/JointState", "/imu": "sensor_msgs/msg/Imu"},
    )
    async with (
        robot(domain, plant=TURTLEBOT, flavour="diff_drive") as daemon,
        node,
    ):
        await node.is_ready()
        node.publish("/cmd_vel", times=500, **fields)
        left = (0.1 + 0.5 * 0.08) / 0.033
        turns = lambda m: m["velocity"][0] == pytest.approx(left, rel=0.02)  # noqa: E731
        joints = await node.sees("/joint_states", turns)
        assert joints["name"] == ["base_to_wheel_left", "base_to_wheel_right"]
        assert joints["velocity"][1] == pytest.approx((0.1 - 0.04) / 0.033, rel=0.02)
        assert joints["position"][0] > joints["position"][1] > 0.0
        await node.sees("/imu", lambda m: m["angular_velocity"]["z"] < -0.45)
        status = daemon.part("ros2").status
        await wait_until(lambda: status.participants == 1, PATIENCE_S)
        assert status.apart == status.strangers == 0
        assert status.fault_counts.total() == 0
        node.process.kill()


async def is_ready_for_one_message(node, daemon):
    """Wait until both sides know each other: a reader loses what an unknown writer sends."""
    await node.is_ready()
    found = [
        e for name, e in daemon.part("ros2")._endpoints() if name.startswith("/rpm")
    ]
    assert len(found) == 2
    await wait_until(lambda: all(endpoint.matched for endpoint in found), PATIENCE_S)


@asynccontextmanager
async def driven_by_keys(domain):
    """The node of the thesis's software in the loop: one message per key press, none between."""
    node = RosNode(
        domain, {"/rpm": FLOATS}, {"/rpm/return": FLOATS}, name="iotbot_motion_control"
    )
    async with (
        robot(domain, flavour="thesis_sil", stale_after_ms=200.0) as daemon,
        node,
    ):
        await is_ready_for_one_message(node, daemon)

        async def press(rpm):
            node.publish("/rpm", data=[rpm, rpm, -rpm, -rpm])
            await node.sees("/rpm/return", lambda m: abs(m["data"][0] - rpm) < 0.5)

        yield daemon, node, press


async def test_what_a_key_commanded_stands_while_its_node_is_there(domain):
    async with driven_by_keys(domain) as (daemon, node, press):
        status = daemon.part("ros2").status
        for rpm in (20.0, 30.0):
            await press(rpm)
            await wait_until(lambda: status.command is CommandState.HELD, PATIENCE_S)
            await asyncio.sleep(0.5)
            assert value(daemon, "wheel.fl.speed_rpm") == pytest.approx(rpm, abs=0.5)
        assert status.lease_s == 20.0
        assert "hil_ros2_command_held 1.0" in await scrape(daemon)
        node.process.stdin.close()
        await wait_until(lambda: daemon.control.state is State.SAFE, PATIENCE_S)
        await wait_until(
            lambda: abs(value(daemon, "wheel.fl.speed_rpm")) < 0.5, PATIENCE_S
        )
        assert any("its writer was alive" in e.message for e in daemon.events.recent)

        # Started again, the node drives after Reset by a new key, not by the one pressed before it.
        again = RosNode(node.domain, {"/rpm": FLOATS}, {"/rpm/return": FLOATS})
        async with again:
            await is_ready_for_one_message(again, daemon)
            again.publish("/rpm", data=[20.0, 20.0, -20.0, -20.0])
            await wait_until(lambda: may_reset(daemon), PATIENCE_S)
            daemon.control.start()
            await asyncio.sleep(0.7)
            assert abs(value(daemon, "wheel.fl.speed_rpm")) < 0.5
            again.publish("/rpm", data=[30.0, 30.0, -30.0, -30.0])
            await again.sees("/rpm/return", lambda m: abs(m["data"][0] - 30.0) < 0.5)


def may_reset(daemon):
    with suppress(ControlRefused):
        daemon.control.reset()
    return daemon.control.state is State.RUNNING


async def test_after_a_stop_a_held_command_does_not_come_back(domain):
    async with driven_by_keys(domain) as (daemon, _, press):
        await press(30.0)
        daemon.control.stop()
        await wait_until(
            lambda: abs(value(daemon, "wheel.fl.speed_rpm")) < 0.5, PATIENCE_S
        )
        daemon.control.reset()
        await asyncio.sleep(0.7)
        assert abs(value(daemon, "wheel.fl.speed_rpm")) < 0.5
        assert daemon.control.state is State.RUNNING
        daemon.control.start()
        await asyncio.sleep(0.7)
        assert abs(value(daemon, "wheel.fl.speed_rpm")) < 0.5
        await press(20.0)


@pytest.mark.long
async def test_a_node_that_is_killed_stops_the_robot_when_its_lease_ends(domain):
    async with driven_by_keys(domain) as (daemon, node, press):
        await press(30.0)
        node.process.kill()
        await asyncio.sleep(5.0)
        assert value(daemon, "wheel.fl.speed_rpm") == pytest.approx(30.0, abs=0.5)
        await wait_until(lambda: daemon.control.state is State.SAFE, GONE_S)


async def test_the_daemon_is_a_node_of_the_graph(domain):
    node = RosNode(domain, {"/left/cmd_vel": TWIST})
    async with robot(domain, namespace="/left"), node:
        await node.is_ready()
        for _ in range(100):
            node.tell(graph=True)
            if "/left/hilserver" in await node.answers("nodes"):
                break
        else:
            raise AssertionError("it has no name")


async def is_known_to_the_service(node, daemon, name, kind):
    """Make a client, and wait until the daemon knows it.

    What a client asks before that is lost: Cyclone DDS skips what a writer has sent before its
    first heartbeat. The client then takes each answer for that to the question before.
    """
    node.tell(client=name, type=kind)
    (service,) = (s for s in daemon.part("ros2")._services if s.name == name)
    await wait_until(lambda: service.endpoints[0].matched, PATIENCE_S)


async def test_services_answer(domain):
    node = RosNode(domain, {"/cmd_vel": TWIST})
    get, listed = (
        "rcl_interfaces/srv/GetParameters",
        "rcl_interfaces/srv/ListParameters",
    )
    async with robot(domain) as daemon, node:
        await node.is_ready()
        for name, kind in (("get_parameters", get), ("list_parameters", listed)):
            await is_known_to_the_service(node, daemon, f"/hilserver/{name}", kind)
        names = ["plant.wheel_radius_m", "plant.track_m"]
        for _ in range(3):
            node.tell(
                call="/hilserver/get_parameters", type=get, fields={"names": names}
            )
            (radius, track) = (await node.answers("answer"))["values"]
            assert radius["double_value"] == daemon.assembly.robot.wheel_radius_m
            assert track["double_value"] == daemon.assembly.robot.track_m
        node.tell(call="/hilserver/list_parameters", type=listed, fields={})
        assert len((await node.answers("answer"))["result"]["names"]) > 10


@pytest.mark.parametrize(
    ("flavour", "types"),
    [
        ("iotbot_shield", "Twist_ here"),
        ("diff_drive", "Twist_ or geometry_msgs::msg::dds_::TwistStamped_ here"),
    ],
)
async def test_a_type_that_does_not_fit_is_told(domain, flavour, types):
    node = RosNode(domain, {"/cmd_vel": "std_msgs/msg/Float32"})
    async with robot(domain, flavour=flavour) as daemon, node:
        status = daemon.part("ros2").status
        await wait_until(lambda: status.apart == status.strangers == 1, PATIENCE_S)
        faults = [
            e.message for e in daemon.events.recent if e.kind is EventKind.PEER_FAULT
        ]
        (told,) = [text for text in faults if "/cmd_vel" in text]
        assert "std_msgs::msg::dds_::Float32_" in told
        assert f"geometry_msgs::msg::dds_::{types}" in told
        shown = await scrape(daemon)
        assert "hil_ros2_endpoints_apart 1.0" in shown
        assert 'hil_ros2_participants{kind="strange"} 1.0' in shown


@asynccontextmanager
async def ear(domain, interface, prefix=()):
    """Our participant in a process of its own, which a namespace can hold."""
    pipe = asyncio.subprocess.PIPE
    process = await asyncio.create_subprocess_exec(
        *(*prefix, sys.executable, "-m", "tests.io.ros2.ear", str(domain), interface),
        stdin=pipe,
        stdout=pipe,
        cwd=ROOT,
    )
    assert await process.stdout.readline() == b"joined\n"
    try:
        yield process
    finally:
        process.stdin.close()
        await process.wait()


async def is_echoed(node):
    await node.is_ready()
    for _ in range(200):
        node.publish("/cmd_vel", **DRIVE)
        await asyncio.sleep(0.02)
        if node.received["/echo"]:
            break
    assert node.received["/echo"][0]["angular"]["z"] == 0.5


@pytest.mark.network
async def test_both_sides_with_their_defaults_find_each_other_on_a_network(domain):
    with peer_network() as network:
        node = RosNode(
            domain,
            {"/cmd_vel": TWIST},
            {"/echo": TWIST},
            discovery=None,
            prefix=network.prefix,
        )
        async with ear(domain, f"{network.name}a"), node:
            await is_echoed(node)


@pytest.mark.network
async def test_on_lo_a_node_that_starts_later_is_found_and_nobody_else_is_heard(domain):
    with peer_network() as network:
        run(*network.prefix, "ip", "link", "set", f"{network.name}b", "down")
        node = RosNode(
            domain,
            {"/cmd_vel": TWIST},
            {"/echo": TWIST},
            discovery=None,
            prefix=network.prefix,
        )
        async with ear(domain, "lo", network.prefix) as ours:
            lines = run(*network.prefix, "ss", "-Hulnp").splitlines()
            places = [line.split()[3] for line in lines if f"={ours.pid}," in line]
            assert len(places) >= 3
            assert all(
                "%lo:" in place or place.startswith("127.0.0.1:") for place in places
            )
            async with node:
                await is_echoed(node)
