"""Recordings of wheeled machines in public repositories, and how each of them is read.

A clone is a folder called as its repository. Nothing of the data is part of this project.
"""

import subprocess
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml
from rosbags.highlevel import AnyReader
from scipy.io import loadmat

from hilserver.arrays import Array, Indices
from hilserver.errors import FailedError

Columns = Mapping[str, Array]
"""``t_s`` and further columns of equal length; NaN where there is no sample."""
ODOMETRY: Final = {
    "odom.linear_m_s": "v",
    "odom.angular_rad_s": "om",
    "nav.x_m": "x",
    "nav.y_m": "y",
    "nav.yaw_rad": "yaw",
}
POSES_HZ: Final = 25.0
"""Poses are taken at this rate or lower."""


@dataclass(frozen=True)
class PublicMachine:
    """One machine, and two drives of it."""

    name: str
    repository: str  # owner and name
    plant: Mapping[str, object]
    channels: Mapping[
        str, str | Mapping[str, object]
    ]  # a column, or all that a mapping says
    drives: Callable[[Path], tuple[Columns, Columns]]

    def clone(self, folder: Path) -> Path:
        """Return where its repository is, in a folder of clones."""
        return folder / self.repository.partition("/")[2]

    def read(self, folder: Path) -> tuple[Columns, Columns]:
        """Return both drives; FailedError if the clone does not hold them."""
        try:
            return self.drives(self.clone(folder))
        except (OSError, KeyError, ValueError, IndexError) as error:
            msg = (
                f"{self.clone(folder)}: {self.name} cannot be read ({error});"
                f" clone {self.repository} again"
            )
            raise FailedError(msg) from None

    def mapping(self) -> str:
        """Return the mapping of its table, as a file holds it."""
        channels = {
            name: {"column": said} if isinstance(said, str) else dict(said)
            for name, said in self.channels.items()
        }
        document: dict[str, object] = {"plant": dict(self.plant), "channels": channels}
        if "odom.linear_m_s" in channels:
            sizes = ("wheel_radius_m", "track_m")
            document["odom"] = {size: self.plant[size] for size in sizes}
        return yaml.safe_dump(document)


def commit(clone: Path) -> str:
    """Return the commit of a clone; a question mark if it is none."""
    command = ["git", "-C", str(clone), "rev-parse", "--short=10", "HEAD"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)  # noqa: S603
    return done.stdout.strip() or "?"


def write_columns(file: Path, columns: Columns) -> None:
    """Write a drive as a table; an empty field stands for a missing sample."""
    table = np.stack(list(columns.values()), axis=1)
    with file.open("w", encoding="utf-8") as opened:
        print(",".join(columns), file=opened)
        for row in table:
            cells = ("" if np.isnan(cell) else f"{cell:.6f}" for cell in row)
            print(",".join(cells), file=opened)


def _halves(columns: Columns) -> tuple[Columns, Columns]:
    """Return the halves of a drive, in time."""
    t_s = columns["t_s"]
    first = t_s < 0.5 * (t_s[0] + t_s[-1])
    before, after = (
        {name: values[own] for name, values in columns.items()}
        for own in (first, ~first)
    )
    return before, after


def _merged(sources: Mapping[str, tuple[Array, Array]]) -> Columns:
    """Return channels with stamps of their own in common rows."""
    t_s = np.unique(np.concatenate([at_s for at_s, _ in sources.values()]))
    columns = {"t_s": t_s - t_s[0]}
    for name, (at_s, values) in sources.items():
        columns[name] = np.full(len(t_s), np.nan)
        columns[name][np.searchsorted(t_s, at_s)] = values
    return columns


def _thinned(t_s: Array) -> Indices:
    """Return the rows of poses that are kept: the first one of each period."""
    _, first = np.unique(np.floor((t_s - t_s[0]) * POSES_HZ), return_index=True)
    return first


def _pioneer(clone: Path) -> tuple[Columns, Columns]:
    """Return half an hour of odometry at 10 Hz beside motion capture."""
    data = {name: np.ravel(v) for name, v in loadmat(clone / "dataset2.mat").items()}
    seen = data["true_valid"] > 0
    poses = {name: np.where(seen, data[f"{of}_true"], np.nan)
             for name, of in (("x", "x"), ("y", "y"), ("yaw", "th"))}  # fmt: skip
    return _halves({"t_s": data["t"], "v": data["v"], "om": data["om"], **poses})


def _scan_matched(clone: Path) -> tuple[Columns, Columns]:
    """Return motions by odometry and by scan matching, without stamps: one each half second."""
    step_s = 0.5
    odometry, seen = (
        np.loadtxt(clone / "resources" / f"{name}_motions.txt")
        for name in ("odom", "scanmatched")
    )
    rows = min(len(odometry), len(seen))
    odometry, seen = odometry[:rows] / step_s, seen[:rows]
    yaw: Array = np.append(0.0, np.cumsum(seen[1:, 2]))
    moved = (seen[:, 0] + 1j * seen[:, 1])[1:] * np.exp(1j * yaw[:-1])
    place = np.append(0.0, np.cumsum(moved))
    # a motion is that since the row before; a speed holds where its row stands
    at_row: Array = odometry.copy()
    at_row[:-1] = 0.5 * (odometry[:-1] + odometry[1:])
    t_s = step_s * np.arange(rows, dtype=np.float64)
    columns: dict[str, Array] = {"t_s": t_s, "v": at_row[:, 0], "om": at_row[:, 2]}
    return _halves(columns | {"x": place.real, "y": place.imag, "yaw": yaw})


def _skid_steered(clone: Path) -> tuple[Columns, Columns]:
    """Return two drives with counts of four encoders and a gyro."""
    return _counted(clone, 20), _counted(clone, 21)


def _counted(clone: Path, run: int) -> Columns:
    with np.load(clone / "data" / f"Encoders{run}.npz") as encoders:
        t_s, counts = encoders["time_stamps"], encoders["counts"]
    with np.load(clone / "data" / f"Imu{run}.npz") as imu:
        gyro = imu["time_stamps"], imu["angular_velocity"][2]
    turned = counts[:, 1:] * (2.0 * np.pi / 360.0) / np.diff(t_s)
    wheels = zip(("fr", "fl", "rr", "rl"), turned, strict=True)
    return _merged(
        {name: (t_s[1:], values) for name, values in wheels} | {"gyro": gyro}
    )


def _mecanum(clone: Path) -> tuple[Columns, Columns]:
    """Return two drives with ticks of four wheels with rollers and motion capture."""
    bags = clone / "project1" / "bags"
    return _of_bag(bags / "bag2.bag"), _of_bag(bags / "bag3.bag")


def _of_bag(file: Path) -> Columns:
    per_turn = 42.0 * 5.0  # ticks of the motor, gear
    wheels: list[tuple[float, ...]] = []
    poses: list[tuple[float, ...]] = []
    with AnyReader([file]) as bag:
        for connection, _, raw in bag.messages():
            message: Any = bag.deserialize(raw, connection.msgtype)
            stamp = message.header.stamp
            at_s = (stamp.sec - 1_600_000_000) + 1e-9 * stamp.nanosec
            if connection.topic == "/wheel_states":
                wheels.append((at_s, *message.position))
            elif connection.topic == "/robot/pose":
                at, q = message.pose.position, message.pose.orientation
                yaw = np.arctan2(
                    2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y**2 + q.z**2)
                )
                poses.append((at_s, at.x, at.y, float(yaw)))
    ticks, seen = np.array(wheels).T, np.array(poses)
    seen = seen[_thinned(seen[:, 0])].T
    turned = np.diff(ticks[1:]) * (2.0 * np.pi / per_turn) / np.diff(ticks[0])
    named = zip(("fl", "fr", "rl", "rr"), turned, strict=True)
    sources = {name: (ticks[0, 1:], values) for name, values in named}
    pose = zip(("x", "y", "yaw"), seen[1:], strict=True)
    return _merged(sources | {name: (seen[0], values) for name, values in pose})


def _of_create(robot: int) -> Callable[[Path], tuple[Columns, Columns]]:
    """Return how two drives of one of five equal robots are read: commands and motion capture."""

    def drives(clone: Path) -> tuple[Columns, Columns]:
        sets = clone / "data" / "MRCLAM_Dataset6", clone / "data" / "MRCLAM_Dataset7"
        first, second = (_commanded(place / f"Robot{robot}") for place in sets)
        return first, second

    return drives


def _commanded(stem: Path) -> Columns:
    odometry, seen = (
        np.loadtxt(f"{stem}_{name}.dat").T for name in ("Odometry", "Groundtruth")
    )
    odometry, seen = (part[:, _thinned(part[0])] for part in (odometry, seen))
    both = max(odometry[0, 0], seen[0, 0]), min(odometry[0, -1], seen[0, -1])
    odometry, seen = (
        part[:, (part[0] >= both[0]) & (part[0] <= both[1])]
        for part in (odometry, seen)
    )
    names = zip(("v", "om"), odometry[1:], strict=True)
    sources = {name: (odometry[0] - both[0], values) for name, values in names}
    pose = zip(("x", "y", "yaw"), seen[1:], strict=True)
    return _merged(
        sources | {name: (seen[0] - both[0], values) for name, values in pose}
    )


def _wheels(*, right_sign: int) -> Iterator[tuple[str, Mapping[str, object]]]:
    for wheel in ("fl", "rl", "fr", "rr"):
        said: dict[str, object] = {"column": wheel, "unit": "rad/s"}
        if wheel.endswith("r"):
            said["sign"] = right_sign
        yield f"wheel.{wheel}.speed_rpm", said


_CREATE: Final = {"wheel_radius_m": 0.033, "track_m": 0.26, "max_rpm": 300}
PUBLIC_MACHINES: Final = (
    PublicMachine(
        "Pioneer, motion capture",
        "17SingerAbel/aer1513",
        {"wheel_radius_m": 0.1, "track_m": 0.4, "max_rpm": 200},
        ODOMETRY,
        _pioneer,
    ),
    PublicMachine(
        "robot in a corridor, scan matching",
        "sManohar201/Least-Squares-Odometry-Calibration",
        {"wheel_radius_m": 0.1, "track_m": 0.4, "max_rpm": 200},
        ODOMETRY,
        _scan_matched,
    ),
    PublicMachine(
        "skid-steered robot, gyro",
        "weixiao-zhan/ECE276A_PR2",
        {"wheel_radius_m": 0.127, "track_m": 0.393, "max_rpm": 200},
        dict(_wheels(right_sign=-1)) | {"imu.gyro_z_rad_s": "gyro"},
        _skid_steered,
    ),
    PublicMachine(
        "four wheels with rollers, motion capture",
        "gabrieleginestroni/ros-robotics-2022",
        {"drive": "mecanum", "wheel_radius_m": 0.07, "wheelbase_m": 0.4, "track_m": 0.338,
         "icr_offset_m": 0.0, "max_rpm": 300},
        dict(_wheels(right_sign=-1))
        | {"nav.x_m": "x", "nav.y_m": "y", "nav.yaw_rad": "yaw"},
        _mecanum,
    ),
    *(
        PublicMachine(
            f"Create {robot}, commands, motion capture",
            "ericguerrero/MUSI-lab-session-1",
            _CREATE,
            ODOMETRY,
            _of_create(robot),
        )
        for robot in range(1, 6)
    ),
)  # fmt: skip
