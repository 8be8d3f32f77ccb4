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


def build(folder: Path) -> Path:
    """Compile the C reference into `folder` and return the shared library.

    FailedError if there is no C compiler or it fails.
    """
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        raise FailedError(
            "the C reference needs gcc, which is not installed; install it (Debian: gcc libc6-dev)"
        )
    library = folder / "plant_reference.so"
    with as_file(files("hilserver.plant.reference").joinpath("plant.c")) as source:
        command = [compiler, *FLAGS, "-o", str(library), str(source), "-lm"]
        done = subprocess.run(  # noqa: S603 (fixed command)
            command, capture_output=True, text=True, timeout=120, check=False
        )
    if done.returncode != 0:
        first = (done.stderr.strip() or "no message").splitlines()[0]
        raise FailedError(f"the C reference does not compile: {first}")
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
        As returned by `build`.
    robot : RobotParameters
        Its physical values are passed by name; the packed ones are not used. For
        friction_anisotropy the C program takes factor and shift, not the balance behind them.
    battery_v : float
        Voltage for battery_sag, constant.
    extended : bool
        Run the steps of all terms, even if all are at null.
    """

    def __init__(
        self, library: Path, robot: RobotParameters, *, battery_v: float, extended: bool
    ) -> None:
        self._library = ctypes.CDLL(str(library))
        self._library.plant_new.restype = ctypes.c_void_p
        self._handle = ctypes.c_void_p(self._library.plant_new())
        values = _physical(robot)
        terms = complete(robot.terms)
        balance = ("friction_anisotropy.ratio", "friction_anisotropy.offset")
        values |= {k: v for k, v in terms.items() if v is not None and k not in balance}
        if robot.wheelbase_m is not None:
            ratio, offset = (terms[name] for name in balance)
            factor, shift_m = anisotropy(
                robot.wheelbase_m,
                robot.track_m,
                float(ratio or 0.0),
                float(offset or 0.0),
            )
            values |= {"aniso_k": factor, "aniso_icr": shift_m}
        values["volts"] = battery_v
        for name, value in values.items():
            if (
                self._library.plant_set(
                    self._handle, name.encode(), ctypes.c_double(value)
                )
                != 0
            ):
                raise FailedError(f"plant.c has no field {name!r}")
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
        self._library.plant_tick(
            self._handle, _pointer(setpoints_rpm), _pointer(self.outputs)
        )

    def sense(self) -> None:
        """Run the sensors on the outputs of the last tick."""
        self._library.plant_sensors(
            self._handle, _pointer(self.outputs), _pointer(self.sensors)
        )

    def run(
        self,
        u: NDArray[np.float64],
        y: NDArray[np.float64],
        q: NDArray[np.int64],
        ticks: int,
    ) -> None:
        """Run whole base ticks with inputs, outputs and status codes, to compare speed."""
        self._library.plant_run(
            self._handle, _pointer(u), _pointer(y), _pointer(q), ctypes.c_long(ticks)
        )
