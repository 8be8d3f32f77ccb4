"""Between ROS 2 and Node-RED: one JSON object a line, over TCP on this computer.

Runs with the Python of a ROS 2 installation that has EduArt's `iotbot_interface`, beside the motion
node: ``python3 ros2_bridge.py [--port 53881]``. Every message of /iotbot/rpm goes to all who are
connected; every line that comes in becomes /iotbot/rpm/return, /iotbot/imu and /iotbot/tof.
"""

import argparse
import contextlib
import json
import math
import socket
import socketserver
import struct
import threading

import rclpy
from iotbot_interface.msg import RotationSpeed
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Imu
from std_msgs.msg import Float32MultiArray

PORT = 53881
WHEELS = {
    "FL": "front_left_rpm",
    "FR": "front_right_rpm",
    "RL": "rear_left_rpm",
    "RR": "rear_right_rpm",
}
FINDERS = ("tof_FL", "tof_FR", "tof_RL", "tof_RR")
LONGEST_LINE = 4096
# who does not read for 0.5 s gets nothing more
PATIENCE = struct.pack("ll", 0, 500_000)


class Bridge(Node):
    """The ROS side: what the shield's node publishes, and the set-points that it reads."""

    def __init__(self):
        super().__init__("iotbot_node_red")
        self.connected = set()
        # as iotbot_shield does: a reader of sensor data takes what any motion node offers
        self.create_subscription(
            RotationSpeed, "iotbot/rpm", self.pass_on, qos_profile_sensor_data
        )
        self._speeds = self.create_publisher(RotationSpeed, "iotbot/rpm/return", 10)
        self._imu = self.create_publisher(Imu, "iotbot/imu", qos_profile_sensor_data)
        self._tof = self.create_publisher(
            Float32MultiArray, "iotbot/tof", qos_profile_sensor_data
        )

    def pass_on(self, message):
        """Send the set-points to all who are connected."""
        speeds = {name: getattr(message, name) for name in WHEELS.values()}
        line = json.dumps(speeds).encode() + b"\n"
        for client in tuple(self.connected):
            try:
                client.sendall(line)
            except OSError:
                self.connected.discard(client)

    def publish(self, values):
        """Publish each topic of which all values are there."""
        if all(f"rpm_act_{wheel}" in values for wheel in WHEELS):
            speeds = {
                name: values[f"rpm_act_{wheel}"] for wheel, name in WHEELS.items()
            }
            self._speeds.publish(RotationSpeed(**speeds))
        if "imu_yaw" in values and "imu_gyro_z" in values:
            self._imu.publish(self._imu_of(values))
        if all(name in values for name in FINDERS):
            self._tof.publish(
                Float32MultiArray(data=[values[name] for name in FINDERS])
            )

    def _imu_of(self, values):
        imu = Imu()
        imu.header.frame_id = "imu_link"
        imu.header.stamp = self.get_clock().now().to_msg()
        imu.orientation.z = math.sin(values["imu_yaw"] / 2.0)
        imu.orientation.w = math.cos(values["imu_yaw"] / 2.0)
        imu.angular_velocity.z = values["imu_gyro_z"]
        imu.linear_acceleration.x = values.get("imu_accel_x", 0.0)
        imu.linear_acceleration.y = values.get("imu_accel_y", 0.0)
        return imu


class Lines(socketserver.StreamRequestHandler):
    """One connection of Node-RED."""

    def handle(self):
        """Publish what comes in, until the other side closes or sends what is no line of ours."""
        bridge = self.server.bridge
        self.request.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, PATIENCE)
        bridge.connected.add(self.request)
        try:
            while line := self.rfile.readline(LONGEST_LINE):
                values = json.loads(line)
                bridge.publish({name: float(value) for name, value in values.items()})
        except (OSError, ValueError, TypeError, AttributeError) as error:
            bridge.get_logger().warning(f"a connection is closed: {error}")
        finally:
            bridge.connected.discard(self.request)


class Server(socketserver.ThreadingTCPServer):
    """Listens on this computer only."""

    allow_reuse_address = daemon_threads = True
    bridge = None


def main():
    """Serve until the node ends."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--port", type=int, default=PORT, help=f"default: {PORT}")
    args = parser.parse_args()
    rclpy.init()
    with Server(("127.0.0.1", args.port), Lines) as server:
        server.bridge = Bridge()
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with contextlib.suppress(ExternalShutdownException, KeyboardInterrupt):
            rclpy.spin(server.bridge)
        server.shutdown()


if __name__ == "__main__":
    main()
