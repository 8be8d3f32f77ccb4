"""Small logs of every kind."""

from functools import cache

import numpy as np
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

RPM = "iotbot_interface/msg/RotationSpeed"
FIELDS = ("front_left_rpm", "front_right_rpm", "rear_left_rpm", "rear_right_rpm")
SQLITE, MCAP = StoragePlugin.SQLITE3, StoragePlugin.MCAP


@cache
def store_of_types():
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg("\n".join(f"float32 {f}" for f in FIELDS), RPM))
    return store


def write_csv(path, header="t_s,wheel.fl.speed_rpm", rows=120, row="{t},{i}", end="\n"):
    """Write rows at 50 Hz; `row` is formatted with t [s] and i."""
    lines = [header, *(row.format(t=0.02 * i, i=i) for i in range(rows))]
    path.write_text("\n".join(lines) + end, encoding="utf-8")
    return path


def write_bag(
    path, storage=SQLITE, n=100, topics=("/iotbot/rpm", "/iotbot/rpm/return"), pose=True
):
    """Write a bag at 50 Hz: number i of a topic holds i, i + 1, i + 2, i + 3 in `FIELDS`."""
    store = store_of_types()
    with Writer(path, version=9, storage_plugin=storage) as writer:
        for topic in topics:
            connection = writer.add_connection(topic, RPM, typestore=store)
            for i in range(n):
                message = store.types[RPM](*(float(i + k) for k in range(4)))
                stamp = 1_700_000_000_000_000_000 + i * 20_000_000
                writer.write(connection, stamp, store.serialize_cdr(message, RPM))
        if pose:
            _write_pose(writer, store, n)
    return path


def _write_pose(writer, store, n):
    kind = "geometry_msgs/msg/PoseStamped"
    t = store.types
    connection = writer.add_connection("/poseStamped", kind, typestore=store)
    for i in range(n):
        received = 1_700_000_000_000_000_000 + i * 20_000_000 + 5_000_000
        made = received - 100_000_000
        stamp = t["builtin_interfaces/msg/Time"](
            sec=made // 10**9, nanosec=made % 10**9
        )
        yaw = 0.01 * i
        message = t[kind](
            header=t["std_msgs/msg/Header"](stamp=stamp, frame_id="map"),
            pose=t["geometry_msgs/msg/Pose"](
                position=t["geometry_msgs/msg/Point"](x=0.1 * i, y=-0.1 * i, z=0.0),
                orientation=t["geometry_msgs/msg/Quaternion"](
                    x=0.0, y=0.0, z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2))
                ),
            ),
        )
        writer.write(connection, received, store.serialize_cdr(message, kind))


def write_chunks(path, n):
    """Write the topics of the wheels as a recorder does that closes a chunk now and then."""
    store = store_of_types()
    text = "\n".join(f"float32 {f}" for f in FIELDS)
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=2000)
        writer.start(profile="ros2")
        schema = writer.register_schema(RPM, "ros2msg", text.encode())
        topics = ("/iotbot/rpm", "/iotbot/rpm/return")
        channels = [writer.register_channel(topic, "cdr", schema) for topic in topics]
        for i in range(n):
            data = bytes(
                store.serialize_cdr(
                    store.types[RPM](*(float(i + k) for k in range(4))), RPM
                )
            )
            for channel in channels:
                writer.add_message(channel, i * 20_000_000, data, i * 20_000_000)
        writer.finish()
    return path


def bag_file(folder):
    """Return the file inside the folder of a bag."""
    return next(file for file in folder.iterdir() if file.suffix in (".db3", ".mcap"))
