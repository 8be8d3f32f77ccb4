"""The poses in a log as trajectories: TUM and KITTI files for evo, `nav_msgs/Odometry` in a bag."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hilserver.arrays import Array
from hilserver.errors import LogError
from hilserver.logs import Log
from hilserver.logs.bag_writer import Storage
from hilserver.logs.log import NS_PER_S
from hilserver.measured.frames import frames_of, is_of_the_daemon, own_sampling
from hilserver.ros.outgoing import (
    UNKNOWN_VARIANCE,
    estimate,
    planar_covariance,
    planar_odometry,
)
from hilserver.ros.robot import Odometer, RosFrame, Shape
from hilserver.ros.types import known_types
from hilserver.signals import MEASURED

TUM_HEAD: Final = "timestamp tx ty tz qx qy qz qw"
LATEST_S: Final = 2**31 - 1  # that a stamp of ROS 2 can hold
BAG_VERSION: Final = 9
TWIST: Final = (
    "velocity.linear_m_s",
    "velocity.lateral_m_s",
    "velocity.angular_rad_s",
)
ABOUT: Final = {"pose": "velocity.", "estimate": "estimate."}
"""First part of the other signals that belong to a pose."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """The poses of one source in one segment of a log."""

    name: str  # as the signals: pose, nav, estimate, measured.nav
    segment: int
    t_s: Array  # shape (n,), rising
    pose: Array  # shape (n, 3): x, y, yaw; a yaw of 0 if there is none
    has_yaw: bool
    about: Mapping[str, Array]  # other signals of its source, shape (n,)


def _as_sampled(
    log: Log,
) -> tuple[dict[str, Array], NDArray[np.int64], dict[str, Array]]:
    """Return columns and segments of the daemon's own log, and how old each sample is [s]."""
    sampling = own_sampling(log)
    measured = {n: v for n, v in log.columns.items() if n.startswith(MEASURED)}
    own = {n: v for n, v in log.columns.items() if n not in measured}
    frames = frames_of(replace(log, columns=own), sampling)
    segment = frames.segment
    columns = dict(frames.columns)
    age_s = dict(frames.age_s)

    # what came from outside loses its prefix, under which the robot's own stands here
    about = {n: v for n, v in own.items() if n.startswith(("internal.", "sim."))}
    frames = frames_of(replace(log, columns=measured | about), sampling)
    columns |= {MEASURED + n: v for n, v in frames.columns.items()}
    age_s |= {MEASURED + n: v for n, v in frames.age_s.items()}
    return columns, segment, age_s


def trajectories_of(log: Log) -> list[Trajectory]:
    """Return every pose that a log holds, segment by segment; LogError if there is none.

    A row of the daemon repeats the newest sample of a slower sensor; here it counts once, at the
    time when it was taken.
    """
    columns = log.columns
    segment = log.segment
    age_s: Mapping[str, Array] = {}
    if is_of_the_daemon(log):
        columns, segment, age_s = _as_sampled(log)

    found: list[Trajectory] = []
    nothing = np.full(len(log), np.nan)
    zero = np.zeros(len(log))
    for name in [n.removesuffix(".x_m") for n in columns if n.endswith(".x_m")]:
        parts = (f"{name}.{part}" for part in ("x_m", "y_m", "yaw_rad"))
        pose = np.column_stack([columns.get(part, nothing) for part in parts])
        is_there = np.isfinite(pose[:, :2]).all(axis=1)
        has_yaw = bool(np.isfinite(pose[is_there, 2]).any())
        if has_yaw:
            is_there &= np.isfinite(pose[:, 2])
        else:
            pose[:, 2] = 0.0
        if name == "estimate":
            is_there &= columns.get("estimate.state", zero + 1.0) != 0.0  # no fix yet
        begin = ABOUT.get(name, " ")
        about = {n: v for n, v in columns.items() if n.startswith(begin)}
        t_s = log.t_s - age_s.get(f"{name}.x_m", zero)
        for number in np.unique(segment[is_there]).tolist():
            rows = np.flatnonzero(is_there & (segment == number))
            # late samples may have the stamp of an earlier one
            newest = np.maximum.accumulate(np.append(-np.inf, t_s[rows]))[:-1]
            rows = rows[t_s[rows] > newest]
            own = {n: v[rows] for n, v in about.items()}
            found.append(Trajectory(name, number, t_s[rows], pose[rows], has_yaw, own))
    if not found:
        raise LogError(
            f"{log.path}: contains no pose, no signals as nav.x_m and nav.y_m; record one, or map"
            " its columns with --mapping"
        )
    return found


def write_tum(found: Sequence[Trajectory], folder: Path, storage: Storage) -> None:
    """Write a file per trajectory: time, place, and heading as a quaternion."""
    del storage
    folder.mkdir(parents=True)
    for one in found:
        half_rad = one.pose[:, 2] / 2.0
        none = np.zeros(len(one.t_s))
        x_m = one.pose[:, 0]
        y_m = one.pose[:, 1]
        sin = np.sin(half_rad)
        cos = np.cos(half_rad)
        rows = np.column_stack([one.t_s, x_m, y_m, none, none, none, sin, cos])
        form = ["%.9f", *["%.17g"] * 7]
        file = folder / f"{_file(one, found)}.tum"
        np.savetxt(file, rows, form, header=TUM_HEAD)


def on_common_times(found: Sequence[Trajectory]) -> list[Trajectory]:
    """Return trajectories of which those of one segment have the same times.

    They are those of the sparsest one, as far as all reach; the others are interpolated.
    """
    common: list[Trajectory] = []
    for number in dict.fromkeys(one.segment for one in found):
        own = [one for one in found if one.segment == number]
        begin_s = max(one.t_s[0] for one in own)
        end_s = min(one.t_s[-1] for one in own)
        t_s = min((one.t_s for one in own), key=len)
        t_s = t_s[(begin_s <= t_s) & (t_s <= end_s)]
        if not len(t_s):
            names = ", ".join(one.name for one in own)
            raise LogError(
                f"segment {number}: {names} have no time in common, and KITTI needs the same rows;"
                " write TUM"
            )
        for one in own:
            x_m, y_m, yaw_rad = one.pose.T
            columns = (x_m, y_m, np.unwrap(yaw_rad))
            moved = [np.interp(t_s, one.t_s, values) for values in columns]
            common.append(replace(one, t_s=t_s, pose=np.column_stack(moved), about={}))
    return common


def write_kitti(found: Sequence[Trajectory], folder: Path, storage: Storage) -> None:
    """Write a file per trajectory, with the upper three rows of a pose as a matrix, and the times.

    The format has no times: what is compared has to have the same rows, see `on_common_times`.
    """
    del storage
    folder.mkdir(parents=True)
    for one in found:
        x_m, y_m, yaw_rad = one.pose.T
        sin = np.sin(yaw_rad)
        cos = np.cos(yaw_rad)
        none = np.zeros(len(one.t_s))
        ones = np.ones(len(one.t_s))
        first = (cos, -sin, none, x_m)
        second = (sin, cos, none, y_m)
        rows = np.column_stack([*first, *second, none, none, ones, none])
        np.savetxt(folder / f"{_file(one, found)}.kitti", rows, "%.17g")
        times = _file(replace(one, name="times"), found)
        np.savetxt(folder / f"{times}.txt", one.t_s, "%.9f")


def write_odometry(found: Sequence[Trajectory], folder: Path, storage: Storage) -> None:
    """Write a bag with a topic of `nav_msgs/Odometry` per trajectory.

    LogError if a stamp of ROS 2 cannot hold the times.
    """
    from rosbags.rosbag2 import StoragePlugin, Writer  # noqa: PLC0415 -- slow to import

    stamps = np.concatenate([one.t_s for one in found])
    if stamps.min() < 0.0 or stamps.max() > LATEST_S:
        raise LogError(
            f"{folder}: times of {stamps.min():.6g} .. {stamps.max():.6g} s do not fit into a"
            " bag; correct the unit of the time column in the mapping, or write TUM"
        )
    nowhere = Shape(1.0, 1.0, 1.0, 1.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0)
    types = known_types()
    robot = RosFrame(types, nowhere, Odometer(nowhere))  # dimensions are in no message
    kind = "nav_msgs/msg/Odometry"
    plugin = {"mcap": StoragePlugin.MCAP, "sqlite3": StoragePlugin.SQLITE3}[storage]
    with Writer(folder, version=BAG_VERSION, storage_plugin=plugin) as writer:
        connections = [
            writer.add_connection(_topic(one, found), kind, typestore=types.store)
            for one in found
        ]
        lengths = [len(one.t_s) for one in found]
        source = np.repeat(np.arange(len(found)), lengths)
        row = np.concatenate([np.arange(length) for length in lengths])
        for index in np.argsort(stamps, kind="stable").tolist():
            one = found[source[index]]
            robot.stamp_ns = round(stamps[index] * NS_PER_S)
            message = _message(robot, one, row[index])
            connection = connections[source[index]]
            writer.write(connection, robot.stamp_ns, types.encode(message))


WRITERS: Final[Mapping[str, Callable[[Sequence[Trajectory], Path, Storage], None]]] = {
    "tum": write_tum,
    "kitti": write_kitti,
    "odometry": write_odometry,
}
"""What writes a format, by the name that a user gives."""


def _message(robot: RosFrame, one: Trajectory, row: int) -> Any:
    values = {n: float(v[row]) for n, v in one.about.items()}
    if one.name == "estimate":
        robot.values = {"estimate.state": 1.0} | values
        with suppress(KeyError):  # a log may hold a part of the estimate
            return next(estimate(robot))

    twist = np.array([values.get(n, np.nan) for n in TWIST])
    motion = np.where(np.isfinite(twist), 0.0, UNKNOWN_VARIANCE)
    ahead, left, turn = np.nan_to_num(twist).tolist()
    x_m, y_m, yaw_rad = one.pose[row].tolist()
    turn_variance = 0.0 if one.has_yaw else UNKNOWN_VARIANCE
    motion_covariance = planar_covariance(*motion.tolist())
    return planar_odometry(
        robot,
        "map",
        (x_m, y_m, yaw_rad),
        planar_covariance(0.0, 0.0, turn_variance),
        (ahead, left, turn),
        motion_covariance,
    )


def _file(one: Trajectory, found: Sequence[Trajectory]) -> str:
    """Return the name of a trajectory's file, numbered if there is more than one segment."""
    is_only = all(other.segment == one.segment for other in found)
    return one.name if is_only else f"{one.name}-{one.segment}"


def _topic(one: Trajectory, found: Sequence[Trajectory]) -> str:
    return "/" + _file(one, found).replace(".", "/").replace("-", "/segment_")
