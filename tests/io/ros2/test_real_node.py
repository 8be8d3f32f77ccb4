"""Real ROS 2 nodes (`rclpy`, rmw_fastrtps) and the daemon: they find each other and exchange."""

import asyncio
import sys
from contextlib import asynccontextmanager

import pytest

from tests.io.ros2.rig import robot
from tests.io.ros2.ros_node import ROOT, RosNode, needs_rclpy
from tests.node_red.black_hole import peer_network, run

pytestmark = needs_rclpy

TWIST = "geometry_msgs/msg/Twist"
DRIVE = {"linear": {"x": 0.2}, "angular": {"z": 0.5}}
SENSORS = {
    "/iotbot/imu": "sensor_msgs/msg/Imu",
    "/iotbot/tof": "std_msgs/msg/Float32MultiArray",
    "/iotbot/temperature": "std_msgs/msg/Float32",
}


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
            domain, {"/cmd_vel": TWIST}, {"/echo": TWIST}, discovery=None, prefix=network.prefix
        )
        async with ear(domain, f"{network.name}a"), node:
            await is_echoed(node)


@pytest.mark.network
async def test_on_lo_a_node_that_starts_later_is_found_and_nobody_else_is_heard(domain):
    with peer_network() as network:
        run(*network.prefix, "ip", "link", "set", f"{network.name}b", "down")
        node = RosNode(
            domain, {"/cmd_vel": TWIST}, {"/echo": TWIST}, discovery=None, prefix=network.prefix
        )
        async with ear(domain, "lo", network.prefix) as ours:
            lines = run(*network.prefix, "ss", "-Hulnp").splitlines()
            places = [line.split()[3] for line in lines if f"={ours.pid}," in line]
            assert len(places) >= 3
            assert all("%lo:" in place or place.startswith("127.0.0.1:") for place in places)
            async with node:
                await is_echoed(node)
