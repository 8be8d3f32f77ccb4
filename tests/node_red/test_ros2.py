"""The wiring of the robot: a real motion node, the shipped bridge and flow, the real Node-RED."""

import asyncio
import contextlib
import json
import os

import pytest

from hilserver.controller.nodes import demo_peer
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from hilserver.signals import State
from tests.helpers.daemons import free_port
from tests.helpers.shared import made_once
from tests.io.ros2.rig import claimed_domain
from tests.io.ros2.ros_node import PYTHON, RosNode, needs_rclpy
from tests.io.ros2.rotation_speed import build
from tests.loopback.rig import configuration, newest, wait_until
from tests.node_red.node_red import DEPLOY, shipped_flow

pytestmark = [pytest.mark.node_red, needs_rclpy]
RPM = "iotbot_interface/msg/RotationSpeed"
SENSORS = {
    "/iotbot/rpm/return": RPM,
    "/iotbot/imu": "sensor_msgs/msg/Imu",
    "/iotbot/tof": "std_msgs/msg/Float32MultiArray",
}
AHEAD = {
    "front_left_rpm": 30.0,
    "front_right_rpm": -30.0,
    "rear_left_rpm": 30.0,
    "rear_right_rpm": -30.0,
}


@pytest.fixture(scope="session")
def interface(tmp_path_factory):
    """The variables by which a node finds EduArt's message."""

    def make(folder):
        path = folder / "environment.json"
        path.write_text(json.dumps(build(folder, PYTHON)))
        return path

    return json.loads(made_once(tmp_path_factory, "rotation_speed", make).read_text())


@contextlib.asynccontextmanager
async def bridge(domain, port, interface):
    """The shipped bridge, as it runs on the robot."""
    own = {"ROS_DOMAIN_ID": str(domain), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    process = await asyncio.create_subprocess_exec(
        PYTHON,
        DEPLOY / "ros2_bridge.py",
        "--port",
        str(port),
        env=os.environ | interface | own,
    )
    try:
        yield process
    finally:
        process.terminate()
        assert await asyncio.wait_for(process.wait(), 60) == 0


async def test_a_motion_node_drives_over_node_red_and_reads_the_sensors(
    node_red, interface
):
    with claimed_domain() as domain:
        port = free_port()
        environment = {"ROS2_PORT": str(port), "IOTBOT_DEMO": "0"}
        controller = node_red(shipped_flow(), environment=environment)
        name = "iotbot_motion_control"
        motion = RosNode(
            domain, {"/iotbot/rpm": RPM}, SENSORS, name=name, more=interface
        )
        async with bridge(domain, port, interface), motion:
            await controller.start()
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(b"no JSON\n")
            assert await reader.read() == b"", (
                "what is no line of ours closes its connection"
            )
            writer.close()
            peer = demo_peer(controller.endpoint, name="iot2050")
            async with Daemon(assemble_config(configuration(peers=[peer]))) as daemon:
                await motion.is_ready()
                motion.publish("/iotbot/rpm", times=1500, **AHEAD)

                def is_fast(speeds):
                    return (
                        speeds["front_left_rpm"] > 25 and speeds["rear_right_rpm"] < -25
                    )

                await motion.sees("/iotbot/rpm/return", is_fast)
                assert daemon.control.state is State.RUNNING
                assert newest(daemon, "wheel.fl.setpoint_rpm") == 30.0
                tof = await motion.sees(
                    "/iotbot/tof", lambda message: len(message["data"]) == 4
                )
                assert all(0.0 <= distance <= 5.0 for distance in tof["data"])
                imu = await motion.sees("/iotbot/imu")
                assert imu["header"]["frame_id"] == "imu_link"
                assert imu["header"]["stamp"]["sec"] > 0
                # a motion node that dies sends nothing: the flow stops the wheels
                motion.process.kill()
                await wait_until(
                    lambda: abs(newest(daemon, "wheel.fl.speed_rpm")) < 0.5
                )
                assert newest(daemon, "drive.enable") == 0.0
