"""How noisy the sensors are, as found by a diagnosis or from their configuration.

No covariance is set by hand: every number here is a sensor's own, or the size of a cause at which a
diagnosis has to name it.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from hilserver.observer.layout import FilterFigures
from hilserver.plant.layout import WHEELS
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.terms import TERMS
from hilserver.plant.units import RAD_S_PER_RPM

WANDER_S: Final = 60.0
"""Time in which slip, rotation gain and gyro bias may drift by what a diagnosis has to name."""
INSTANT_SD: Final = 1.0 / math.sqrt(24.0)
"""Share of a step by which all jumps of the wheels are early or late together: half the variance of
an unknown instant, see `motion.BEND`."""
# consecutive refused samples until the robot counts as carried
READMIT_AFTER: Final = 10
OF_SPEED: Final = (
    "wheel_radius",
    "traction_slip",
    "longitudinal_slip",
    "acceleration_slip",
)
OF_TURNING: Final = (
    "rotation_gain",
    "rotation_gain_speed",
    "friction_anisotropy.ratio",
)
"""Terms of slip: if a model has one, the state of the same kind is neither uncertain nor drifts."""
_LEAST_RPM: Final = 0.01
_LEAST_M: Final = 1e-3
_LEAST_RAD: Final = 1e-4


@dataclass(frozen=True, slots=True)
class MeasuredNoise:
    """Noise of a channel, in its unit."""

    # standard deviation of the part that is independent in every sample
    white: float = 0.0
    slow: float = 0.0  # of the part that is correlated in time, over `tau_s`
    tau_s: float = 1.0
    step: float = 0.0  # resolution: readings are multiples of it; 0: not rounded

    @property
    def of_a_sample(self) -> float:
        """Standard deviation of the part not correlated in time, rounding included."""
        return math.hypot(self.white, self.step / math.sqrt(12.0))

    @property
    def drift(self) -> float:
        """The part correlated in time, as variance of its integral per second."""
        return 2.0 * self.slow * self.slow * self.tau_s


def configured(robot: RobotParameters) -> dict[str, MeasuredNoise]:
    """Return the noise of the configured sensors by channel."""
    nav, terms = robot.nav, robot.terms
    place = MeasuredNoise(nav.white_noise_m, nav.correlated_noise_m, nav.correlation_s)
    speed = MeasuredNoise(step=terms.get("encoder_quantization") or 0.0)
    return {
        **{f"wheel.{wheel}.speed_rpm": speed for wheel in WHEELS},
        "imu.gyro_z_rad_s": MeasuredNoise(robot.imu.gyro_noise_rad_s),
        "nav.x_m": place,
        "nav.y_m": place,
        "nav.yaw_rad": MeasuredNoise(0.0, nav.yaw_noise_rad, nav.yaw_correlation_s),
    }


def _mean(*found: MeasuredNoise) -> MeasuredNoise:
    """Return the noise whose variance is the mean of several."""
    n = len(found)

    def rms(values: list[float]) -> float:
        return math.sqrt(sum(value * value for value in values) / n)

    slow = rms([one.slow for one in found])
    tau = sum(one.slow * one.slow * one.tau_s for one in found)
    return MeasuredNoise(
        rms([one.white for one in found]),
        slow,
        tau / (n * slow * slow) if slow > 0.0 else 1.0,
        rms([one.step for one in found]),
    )


def figures(
    robot: RobotParameters,
    noise: Mapping[str, MeasuredNoise],
    *,
    unknown: Mapping[str, float] | None = None,
    wanders: bool = False,
    readmit_after: int = READMIT_AFTER,
) -> FilterFigures:
    """Return the figures of the filter.

    Parameters
    ----------
    noise : mapping of Noise
        By channel; a missing one has the noise of the configured sensor.
    unknown : mapping of float, optional
        By cause, the largest size that a diagnosis may have missed. Without a diagnosis all
        may have the size at which one has to name them, and drift.
    wanders : bool
        The diagnosis found an unknown structure: `unknown` then bounds only constant effects, and
        one that drifts may be as large as without a diagnosis.
    """
    shown = configured(robot) | dict(noise)
    c = FilterFigures.zeros()
    c.nav_period, c.imu_period = robot.nav.period_s, robot.imu.period_s
    c.readmit_after, c.instant_sd = readmit_after, INSTANT_SD
    wheels = _mean(*(shown[f"wheel.{wheel}.speed_rpm"] for wheel in WHEELS))
    c.wheel_sd = max(wheels.of_a_sample, _LEAST_RPM) / math.sqrt(2.0) * RAD_S_PER_RPM
    c.wheel_drift = 0.5 * wheels.drift * RAD_S_PER_RPM**2
    gyro = shown["imu.gyro_z_rad_s"]
    c.gyro_sd, c.gyro_drift = max(gyro.of_a_sample, _LEAST_RAD), gyro.drift
    place, yaw = _mean(shown["nav.x_m"], shown["nav.y_m"]), shown["nav.yaw_rad"]
    c.position_sd = max(place.of_a_sample, _LEAST_M)
    c.position_ou, c.position_tau = place.slow, place.tau_s
    c.yaw_sd = max(yaw.of_a_sample, _LEAST_RAD)
    c.yaw_ou, c.yaw_tau = yaw.slow, yaw.tau_s
    _leave_unknown(c, robot, unknown, wanders=wanders)
    return c


def _leave_unknown(
    c: FilterFigures,
    robot: RobotParameters,
    unknown: Mapping[str, float] | None,
    *,
    wanders: bool,
) -> None:
    """Set how far gyro bias, slip and rotation gain may be off, and how fast they drift."""
    on = {
        name
        for name, value in robot.terms.items()
        if value not in (None, TERMS[name].null)
    }
    for name, cause, covered_by in (
        ("bias", "gyro_bias", ("gyro_bias",)),
        ("slip", "wheel_radius", OF_SPEED),
        ("gain", "rotation_gain", OF_TURNING),
    ):
        reference = TERMS[cause].reference or 0.0
        size = reference if unknown is None else 0.5 * unknown.get(cause, 0.0)
        if wanders and size > 0.0:
            size = max(size, reference)
        sd = 0.0 if on.intersection(covered_by) else size
        c[f"{name}_sd"] = sd
        c[f"{name}_walk"] = sd * sd / WANDER_S if unknown is None or wanders else 0.0
