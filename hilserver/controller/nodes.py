"""Names of the controller's nodes, and the peer configuration that fits them.

The Node-RED flow in deploy/node-red serves the same nodes, so that both can be exchanged.
"""

from hilserver.config.peers import PeerConfig

NAMESPACE = "urn:iotbot:agv"

SETPOINTS = {
    "rpm_set_FL": "wheel.fl.setpoint_rpm",
    "rpm_set_RL": "wheel.rl.setpoint_rpm",
    "rpm_set_FR": "wheel.fr.setpoint_rpm",
    "rpm_set_RR": "wheel.rr.setpoint_rpm",
    "enable": "drive.enable",
}
"""Node -> our input."""

SEQUENCE = "seq"

SENSORS = {
    "rpm_act_FL": "wheel.fl.speed_rpm",
    "rpm_act_RL": "wheel.rl.speed_rpm",
    "rpm_act_FR": "wheel.fr.speed_rpm",
    "rpm_act_RR": "wheel.rr.speed_rpm",
    "pose_x": "pose.x_m",
    "pose_y": "pose.y_m",
    "pose_yaw": "pose.yaw_rad",
    "imu_gyro_z": "imu.gyro_z_rad_s",
    "imu_yaw": "imu.yaw_rad",
    "imu_accel_x": "imu.accel_x_m_s2",
    "imu_accel_y": "imu.accel_y_m_s2",
    "battery_voltage": "battery.voltage_v",
    "tof_FL": "tof.fl_m",
    "tof_FR": "tof.fr_m",
    "tof_RL": "tof.rl_m",
    "tof_RR": "tof.rr_m",
}
"""Node -> our output that is written to it."""


def node_id(name: str) -> str:
    """Return the node id of `name` for a peer configuration."""
    return f"nsu={NAMESPACE};s={name}"


def demo_peer(endpoint: str, *, name: str = "controller") -> PeerConfig:
    """Return the peer configuration of the embedded controller at `endpoint`."""
    read = {node_id(node): signal for node, signal in SETPOINTS.items()}
    written = {signal: node_id(node) for node, signal in SENSORS.items()}
    return PeerConfig(
        name=name,
        endpoint=endpoint,
        read=read,
        sequence_node=node_id(SEQUENCE),
        write=written,
    )
