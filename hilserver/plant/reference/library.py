"""Builds `plant.c` and drives it with physical values by name."""

import ctypes
import shutil
import subprocess
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hilserver.errors import FailedError
from hilserver.plant.friction import anisotropy
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.terms import complete

N_OUTPUTS: Final = 20
N_STATES: Final = 12
N_SENSORS: Final = 7
FLAGS: Final = ("-std=gnu11", "-O3", "-march=native", "-fPIC", "-shared")

FIELDS: Final = {
    "process_gain": "a_gain",
    "time_constant": "a_t1",
    "saturation_limit": "limit",
    "coulomb_friction": "coulomb",
    "viscous_load": "viscous",
    "dead_zone": "dead_zone",
    "stribeck_friction.f_s": "f_s",
    "stribeck_friction.n_s": "n_s",
    "wheel_load.f": "load",
    "wheel_load.wheel": "load_wheel",
    "battery_sag": "sag_k",
    "actuation_delay": "actuation_delay",
    "setpoint_rate_limit": "rate_limit",
    "control_period": "control_period",
    "controller_gains.p": "a_p",
    "controller_gains.i": "a_i",
    "encoder_scale.a": "encoder_a",
    "encoder_scale.wheel": "encoder_wheel",
    "encoder_filter": "encoder_filter",
    "encoder_quantization": "quantum",
    "backlash": "backlash",
    "wheel_radius": "a_radius",
    "wheel_radius_difference": "a_diff",
    "rotation_gain": "a_k",
    "rotation_gain_speed": "a_kv",
    "rotation_gain_radius": "a_kq",
    "traction_slip": "traction",
    "roller_slip": "roller",
    "body_lag": "lag",
    "longitudinal_slip": "long_slip",
    "acceleration_slip": "acc_slip",
    "side_slip": "side_slip",
    "icr_offset": "icr_d",
    "wheel_misalignment": "misalign",
    "floor_slope.x": "slope_x",
    "floor_slope.y": "slope_y",
    "surface_change.k_om": "surf_k",
    "surface_change.v": "surf_v",
    "surface_change.x_min": "x_min",
    "surface_change.x_max": "x_max",
    "surface_change.y_min": "y_min",
    "surface_change.y_max": "y_max",
    "wheel_runout.amplitude": "runout",
    "wheel_runout.phase": "runout_phase",
    "nav_frame_yaw": "frame_yaw",
    "nav_lever_arm.x": "lever_x",
    "nav_lever_arm.y": "lever_y",
    "nav_latency": "nav_latency",
    "yaw_latency": "yaw_latency",
    "nav_scale": "nav_scale",
    "nav_position_bias.amplitude": "bias",
    "nav_position_bias.wavelength": "bias_length",
    "nav_outliers.share": "outlier_share",
    "nav_outliers.size": "outlier_size",
    "heading_distortion.a1": "dist_a1",
    "heading_distortion.phase1": "dist_p1",
    "heading_distortion.a2": "dist_a2",
    "heading_distortion.phase2": "dist_p2",
    "gyro_bias": "gyro_bias",
    "gyro_scale": "gyro_a",
    "imu_latency": "imu_latency",
}


def build(folder: Path) -> Path:
    """Compile the C reference into `folder` and return the shared library.

    Raises
    ------
    FailedError
        When there is no C compiler or it fails.
    """
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        msg = (
            "the C reference needs gcc, which is not installed; install it (Debian: gcc libc6-dev)"
        )
        raise FailedError(msg)
    library = folder / "plant_reference.so"
    with as_file(files("hilserver.plant.reference").joinpath("plant.c")) as source:
        command = [compiler, *FLAGS, "-o", str(library), str(source), "-lm"]
        done = subprocess.run(  # noqa: S603 (fixed command)
            command, capture_output=True, text=True, timeout=120, check=False
        )
    if done.returncode != 0:
        first = (done.stderr.strip() or "no message").splitlines()[0]
        msg = f"the C reference does not compile: {first}"
        raise FailedError(msg)
    return library


def _physical(robot: RobotParameters) -> dict[str, float]:
    controller, process = robot.controller, robot.process
    return {
        "T": robot.period_s,
        "r": robot.wheel_radius_m,
        "max_rpm": robot.max_rpm,
        "ly": robot.track_m,
        "icr": robot.icr_offset_m,
        "k_om": robot.k_om,
        "yaw_sign": float(robot.yaw_sign),
        "mecanum": float(robot.is_mecanum),
        "kp": controller.k_p,
        "ki": controller.k_i,
        "kd": controller.k_d,
        "N": controller.derivative_n,
        "limit_pct": controller.limit_pct,
        "G": process.gain,
        "T1": process.t1_s,
        "T2": process.t2_s,
        "Ts": robot.nav.period_s,
        "nav_every": 1.0 / (robot.nav.rate_hz * robot.nav.period_s),
        "seed": float(robot.seed),
    }


def _pointer(array: NDArray[Any]) -> ctypes.c_void_p:
    return array.ctypes.data_as(ctypes.c_void_p)


class ReferencePlant:
    """One robot of the C program.

    Parameters
    ----------
    library : Path
        What `build` returned.
    robot : RobotParameters
        Its physical values are handed over by name; the packed ones are not used. Of
        friction_anisotropy the C program takes factor and shift, not the balance behind them.
    battery_v : float
        Voltage for battery_sag, constant.
    extended : bool
        Run the steps of all terms, even if all are null.
    """

    def __init__(
        self, library: Path, robot: RobotParameters, *, battery_v: float, extended: bool
    ) -> None:
        self._library = ctypes.CDLL(str(library))
        self._library.plant_new.restype = ctypes.c_void_p
        self._handle = ctypes.c_void_p(self._library.plant_new())
        values = _physical(robot)
        terms = complete(robot.terms)
        for name, value in terms.items():
            if name in FIELDS and value is not None:
                values[FIELDS[name]] = value
        if robot.wheelbase_m is not None:
            ratio, offset = (terms[f"friction_anisotropy.{part}"] for part in ("ratio", "offset"))
            factor, shift_m = anisotropy(
                robot.wheelbase_m, robot.track_m, float(ratio or 0.0), float(offset or 0.0)
            )
            values |= {"aniso_k": factor, "aniso_icr": shift_m}
        values["volts"] = battery_v
        for name, value in values.items():
            if self._library.plant_set(self._handle, name.encode(), ctypes.c_double(value)) != 0:
                msg = f"plant.c has no field {name!r}"
                raise FailedError(msg)
        self._library.plant_prepare(self._handle, int(extended))
        self.outputs = np.zeros(N_OUTPUTS)
        self.states = np.zeros(N_STATES)
        self.sensors = np.zeros(N_SENSORS)

    def close(self) -> None:
        """Free the robot."""
        self._library.plant_free(self._handle)

    def tick(self, setpoints_rpm: NDArray[np.float64]) -> None:
        """Read the state of t_k, then run one tick."""
        self._library.plant_state(self._handle, _pointer(self.states))
        self._library.plant_tick(self._handle, _pointer(setpoints_rpm), _pointer(self.outputs))

    def sense(self) -> None:
        """Run the sensors on the outputs of the last tick."""
        self._library.plant_sensors(self._handle, _pointer(self.outputs), _pointer(self.sensors))

    def run(
        self,
        u: NDArray[np.float64],
        y: NDArray[np.float64],
        q: NDArray[np.int64],
        ticks: int,
    ) -> None:
        """Run whole base ticks with inputs, outputs and status codes: the speed comparison."""
        self._library.plant_run(
            self._handle, _pointer(u), _pointer(y), _pointer(q), ctypes.c_long(ticks)
        )
