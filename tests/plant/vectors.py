"""The conformance vectors: one manoeuvre, the base robot, and one robot per term.

`inputs.csv` of `hilserver/plant/reference/vectors` holds the ticks at which the set-points change;
every other file starts with the terms it was made with and holds every `EVERY`-th tick: outputs of
t_k, state of t_k, sensors.
"""

import csv
import io
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilserver.plant import reference
from hilserver.plant.imu import imu_step
from hilserver.plant.layout import WHEELS, Inputs, Outputs, Status
from hilserver.plant.nav import nav_step
from hilserver.plant.packing import initial_state, pack
from hilserver.plant.parameters import (
    FOR_MECANUM_ALONE,
    MECANUM_GEOMETRY,
    Navigation,
    RobotParameters,
)
from hilserver.plant.reference.cases import cases
from hilserver.plant.robot import robot_step

FOLDER: Final = Path(reference.__file__).parent / "vectors"
TICKS: Final = 600
EVERY: Final = 20
SENSOR_TICKS: Final = 10
_SETPOINTS: Final = (
    (0, (30.0, 30.0, -20.0, -20.0)),
    (60, (90.0, 90.0, -90.0, -90.0)),
    (200, (-5.0, -5.0, 3.0, 3.0)),
    (330, (0.0, 0.0, 0.0, 0.0)),
    (420, (10.0, 12.0, -40.0, -38.0)),
)
WHEEL_COLUMNS: Final = [
    f"wheel.{w}.{what}"
    for what in ("speed_rpm", "duty_pct", "angle_rad")
    for w in WHEELS
]
COLUMNS: Final = [
    *WHEEL_COLUMNS,
    *("pose.x_m", "pose.y_m", "pose.yaw_rad"),
    *("velocity.linear_m_s", "velocity.lateral_m_s", "velocity.angular_rad_s"),
    *("accel_x_m_s2", "accel_y_m_s2"),
    *(
        f"state.{w}.{what}"
        for what in ("motor", "speed_rpm", "integral_pct")
        for w in WHEELS
    ),
    *("imu.gyro_z_rad_s", "imu.yaw_rad", "imu.accel_x_m_s2", "imu.accel_y_m_s2"),
    *("nav.x_m", "nav.y_m", "nav.yaw_rad"),
]


def robot_of(terms: dict[str, float]) -> RobotParameters:
    """Return the robot of a vector file: navigation on, without random noise.

    Terms of rollers are those of a mecanum robot.
    """
    nav = Navigation(
        enabled=True, white_noise_m=0.0, correlated_noise_m=0.0, yaw_noise_rad=0.0
    )
    robot = RobotParameters(nav=nav)
    if not FOR_MECANUM_ALONE.isdisjoint(terms):
        robot = replace(robot, drive="mecanum", **MECANUM_GEOMETRY)  # type: ignore[arg-type]
    return replace(robot, terms=terms)


def setpoints(tick: int) -> NDArray[np.float64]:
    """Return the set-points [rpm] of a tick, shape (4,)."""
    latest = [value for start, value in _SETPOINTS if start <= tick][-1]
    return np.array(latest)


def drive(robot: RobotParameters) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """Run the manoeuvre with the compiled plant; yield tick and numbers as in `COLUMNS`."""
    p = pack(robot)
    x, u, y, q = initial_state(robot), Inputs.zeros(), Outputs.zeros(), Status.zeros()
    u.enable = 1.0
    for tick in range(TICKS):
        u.setpoint[:] = setpoints(tick)
        state = np.concatenate([x.motor, x.speed, x.integral])
        robot_step(p, x, u, y, q)
        if tick % SENSOR_TICKS == 0:
            imu_step(p, x, u, y, q)
            nav_step(p, x, u, y, q)
        moved = y.numbers[: Outputs.where("angular").stop]
        sensed = [y.gyro, y.heading, y.accel_x, y.accel_y, *y.nav]
        yield tick, np.concatenate([moved, [x.accel_x, x.accel_y], state, sensed])


def to_csv(terms: dict[str, float]) -> str:
    """Return the text of a vector file."""
    text = io.StringIO()
    text.write(
        "# " + " ".join(f"{name}={value!r}" for name, value in terms.items()) + "\n"
    )
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["tick", *COLUMNS])
    for tick, numbers in drive(robot_of(terms)):
        if tick % EVERY == 0:
            writer.writerow([tick, *(repr(float(v)) for v in numbers)])
    return text.getvalue()


def inputs_csv() -> str:
    """Return the text of the file of set-point changes."""
    rows = [",".join(["tick", *(f"wheel.{w}.setpoint_rpm" for w in WHEELS)])]
    rows += [",".join([str(tick), *map(repr, values)]) for tick, values in _SETPOINTS]
    return "\n".join(rows) + "\n"


def read(name: str) -> tuple[dict[str, float], NDArray[np.int64], NDArray[np.float64]]:
    """Return terms, ticks and numbers of a shipped vector file."""
    head, *lines = (FOLDER / f"{name}.csv").read_text(encoding="utf-8").splitlines()
    terms = dict(item.split("=") for item in head.lstrip("# ").split())
    rows = list(csv.reader(lines))[1:]
    ticks = np.array([int(row[0]) for row in rows])
    numbers = np.array([[float(v) for v in row[1:]] for row in rows])
    return {key: float(value) for key, value in terms.items()}, ticks, numbers


def main() -> None:
    """Write all files anew: after a deliberate change that the C reference agrees with."""
    (FOLDER / "inputs.csv").write_text(inputs_csv(), encoding="utf-8")
    for name, terms in cases().items():
        (FOLDER / f"{name}.csv").write_text(to_csv(terms), encoding="utf-8")


if __name__ == "__main__":
    main()
