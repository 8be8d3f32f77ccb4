"""A minute of a real ROS 2 node beside the daemon: how soon, how much, and every call."""

import json
import time

import pytest

from tests.io.ros2.rig import PATIENCE_S, robot
from tests.io.ros2.ros_node import RosNode, needs_rclpy
from tests.io.ros2.test_real_node import TWIST
from tests.loopback.rig import wait_until

pytestmark = [needs_rclpy, pytest.mark.long, pytest.mark.timeout(600)]

RATE_HZ, MINUTE = 50.0, 3000
IMU = "sensor_msgs/msg/Imu"
GET = "rcl_interfaces/srv/GetParameters"


@pytest.fixture
def drive(tmp_path):
    """A minute of twists at 50 Hz, each another one."""
    path = tmp_path / "drive.jsonl"
    rows = (
        {
            "at_s": i / RATE_HZ,
            "topic": "/cmd_vel",
            "fields": {"linear": {"x": 0.1}, "angular": {"z": i * 1e-4}},
        }
        for i in range(MINUTE)
    )
    path.write_text("".join(json.dumps(row) + "\n" for row in rows))
    return path


async def test_a_minute_at_50_hz_arrives_both_ways(domain, drive):
    node = RosNode(domain, {"/cmd_vel": TWIST}, {"/iotbot/imu": IMU})
    async with robot(domain) as daemon, node:
        begun_s = time.monotonic()
        await node.sees("/iotbot/imu")
        found_s = time.monotonic() - begun_s  # the start of its Python included
        await node.is_ready()

        status = daemon.part("ros2").status
        await wait_until(lambda: status.participants == 1, PATIENCE_S)
        before = len(node.received["/iotbot/imu"])
        node.play(drive)
        await node.answers("played")
        imu = node.received["/iotbot/imu"][before:]
        stamps_s = [
            stamp["sec"] + stamp["nanosec"] * 1e-9
            for stamp in (message["header"]["stamp"] for message in imu)
        ]
        sent = round((stamps_s[-1] - stamps_s[0]) * RATE_HZ) + 1

        answered = 0
        for _ in range(50):
            node.tell(
                call="/hilserver/get_parameters",
                type=GET,
                fields={"names": ["plant.track_m"]},
            )
            [track] = (await node.answers("answer"))["values"]
            answered += track["double_value"] == daemon.assembly.robot.track_m

        taken = status.sequence_received / MINUTE
        print(f"found in {found_s:.2f} s, {taken:.2%} of commands,", end=" ")
        print(f"{len(imu) / sent:.2%} of {sent} IMU messages, {answered} of 50 calls")
        assert found_s < 5.0
        assert taken >= 0.99
        assert len(imu) >= 0.99 * sent > 2900
        assert answered == 50
