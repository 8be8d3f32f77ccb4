"""Parts of the robot with their default figures, in physical units.

The numbers are those of the thesis (equation numbers are its own) for EduArt's "IOT Bot" in its
skid-steer build; the plant reference names the source of each.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Controller:
    """Wheel speed controller (5.4): gains in parallel form, error in rpm, output in % duty."""

    k_p: float = 13.513
    k_i: float = 195.84
    k_d: float = 0.0
    derivative_n: float = 10.0
    limit_pct: float = 100.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Process:
    """Motor, gear and wheel (5.23): two first-order lags in cascade, gain in rpm per % duty."""

    gain: float = 1.11
    t1_s: float = 0.069
    t2_s: float = 0.0023


@dataclass(frozen=True, slots=True, kw_only=True)
class Imu:
    """Inertial unit: slice and white noise (standard deviations)."""

    enabled: bool = True
    period_s: float = 0.01
    gyro_noise_rad_s: float = 0.0
    accel_noise_m_s2: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Battery:
    """NiMH pack 19.2 V (4.2): charge is counted, the voltage falls over the inner resistance."""

    enabled: bool = True
    period_s: float = 0.01
    capacity_ah: float = 3.0
    initial_charge: float = 0.9
    resistance_ohm: float = 0.15
    idle_current_a: float = 0.8
    full_duty_current_a: float = 1.5


@dataclass(frozen=True, slots=True, kw_only=True)
class RangeFinders:
    """Four range finders at the corners: the front ones look forward, the rear ones backward."""

    enabled: bool = True
    period_s: float = 0.01
    mount_x_m: float = 0.20
    mount_y_m: float = 0.12
    field_of_view_rad: float = 0.1745


@dataclass(frozen=True, slots=True, kw_only=True)
class Navigation:
    """Navigation tag (Pozyx in the thesis): rate and noise of an ultra-wideband system."""

    enabled: bool = False
    period_s: float = 0.01
    rate_hz: float = 20.0
    lever_arm_x_m: float = 0.0
    lever_arm_y_m: float = 0.0
    latency_s: float = 0.0
    yaw_latency_s: float = 0.0
    white_noise_m: float = 0.01
    correlated_noise_m: float = 0.08
    correlation_s: float = 0.6
    yaw_noise_rad: float = 0.0175
    yaw_correlation_s: float = 2.0
