"""Drives of a "real" robot: simulated with another floor, played by a real node at real rates."""

import json
import math

import numpy as np
import yaml
from hilserver_injector.make import make
from hilserver_injector.recipe import Recipe

from hilserver.commands import main
from hilserver.logs import read_log
from hilserver.plant.layout import WHEELS

TURNS_MORE = 0.08
"""The real robot turns so much more than its wheels say, which the daemon's model does not know."""
FLOATS, IMU = "std_msgs/msg/Float32MultiArray", "sensor_msgs/msg/Imu"
TAG = "geometry_msgs/msg/PoseStamped"
SETPOINTS = "/rpm"
REAL = {"/real/rpm/return": FLOATS, "/real/imu": IMU, "/real/poseStamped": TAG}
MEASURED = {
    "namespace": "/real",
    "topics": {
        "rpm/return": "Float32MultiArray",
        "imu": "Imu",
        "poseStamped": "PoseStamped",
    },
}
FAST_MS, TAG_MS = 20, 100


def recorded(folder, drive, name="drive.jsonl"):
    """Simulate a drive (a scenario, or a log of set-points) on the other floor; return the file."""
    configuration = {
        "plant": {"terms": {"rotation_gain": TURNS_MORE}},
        "sensors": {"nav": {"enabled": True}, "imu": {"gyro_noise_rad_s": 0.006}},
    }
    real, log, out = folder / "real.yaml", folder / "real.mcap", folder / name
    real.write_text(yaml.safe_dump(configuration), encoding="utf-8")
    assert main(["simulate", str(drive), "-c", str(real), "-o", str(log)]) == 0
    read = read_log(log).columns
    columns = {
        name: read[name]
        for name in read
        if name.split(".")[0] in ("wheel", "imu", "nav")
    }
    with out.open("w", encoding="utf-8") as lines:
        for k in range(0, len(columns["nav.x_m"]), FAST_MS):
            for topic, fields in _messages(
                {name: float(v[k]) for name, v in columns.items()}, k
            ):
                line = {"at_s": 1e-3 * k, "topic": topic, "fields": fields}
                lines.write(json.dumps(line) + "\n")
    return out


def wandering(path, length_s, seed=1):
    """Write a log of set-points that move on ramps, as the robot of ``run --twin`` does."""
    table, _ = make(Recipe(seed=seed, manoeuvre="ramps", duration_s=length_s))
    names = [f"wheel.{wheel}.setpoint_rpm" for wheel in WHEELS]
    rows = np.column_stack([table.t_s, *(table.columns[name] for name in names)])
    rows = rows[np.isfinite(rows).all(axis=1)]
    np.savetxt(path, rows, "%.6g", ",", header=",".join(["t_s", *names]), comments="")
    return path


def _messages(v, k):
    """Yield topic and fields of what the robot and its host send at a millisecond."""
    yield SETPOINTS, {"data": [v[f"wheel.{w}.setpoint_rpm"] for w in WHEELS]}
    yield "/real/rpm/return", {"data": [v[f"wheel.{w}.speed_rpm"] for w in WHEELS]}
    force = {"x": v["imu.accel_x_m_s2"], "y": v["imu.accel_y_m_s2"], "z": 9.81}
    rate = {"z": v["imu.gyro_z_rad_s"]}
    yield "/real/imu", {"angular_velocity": rate, "linear_acceleration": force}
    if k % TAG_MS == 0:
        place = {"x": v["nav.x_m"], "y": v["nav.y_m"]}
        half = 0.5 * v["nav.yaw_rad"]
        heading = {"z": math.sin(half), "w": math.cos(half)}
        pose = {"position": place, "orientation": heading}
        yield "/real/poseStamped", {"header": {"frame_id": "map"}, "pose": pose}
