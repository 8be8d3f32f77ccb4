"""Parts of the robot with their default figures, in physical units.

The figures, and the equation numbers, are those of the thesis for EduArt's "IOT Bot" in its
skid-steer build; the plant reference names the source of each.
"""

from dataclasses import dataclass

from hilserver.plant.quantity import quantity


@dataclass(frozen=True, slots=True, kw_only=True)
class Controller:
    """Wheel speed controller (5.4): gains in parallel form, error in rpm, output in % duty."""

    k_p: float = quantity(
        13.513, "proportional gain", unit="%/rpm", jumps="duty", ge=0, le=1e6
    )
    k_i: float = quantity(195.84, "integral gain", unit="%/(rpm·s)", ge=0, le=1e9)
    k_d: float = quantity(
        0.0, "derivative gain", unit="%·s/rpm", jumps="duty", ge=0, le=1e6
    )
    derivative_n: float = quantity(
        10.0,
        "derivative filter: tau = k_d / (derivative_n k_p)",
        jumps="duty",
        gt=0,
        le=1e6,
    )
    limit_pct: float = quantity(
        100.0, "limit of the duty, both signs", jumps="duty", gt=0, le=1000
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Process:
    """Motor, gear and wheel (5.23): two first-order lags in cascade, gain in rpm per % duty."""

    gain: float = quantity(1.11, "speed per duty", unit="rpm/%", gt=0, le=1e4)
    t1_s: float = quantity(0.069, "slow time constant", ge=1e-9, le=100)
    t2_s: float = quantity(0.0023, "fast time constant", jumps="imu", ge=1e-9, le=100)


@dataclass(frozen=True, slots=True, kw_only=True)
class Imu:
    """Inertial unit: slice and white noise (standard deviations)."""

    enabled: bool = True
    period_s: float = quantity(0.01, "period of its slice", jumps="fixed", gt=0)
    gyro_noise_rad_s: float = quantity(0.0, "white noise, sd", jumps="imu", ge=0, le=10)
    accel_noise_m_s2: float = quantity(
        0.0, "white noise, sd", jumps="imu", ge=0, le=100
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Battery:
    """NiMH pack 19.2 V (4.2): charge is counted, the voltage falls over the inner resistance."""

    enabled: bool = True
    period_s: float = quantity(0.01, "period of its slice", jumps="fixed", gt=0)
    capacity_ah: float = quantity(3.0, "charge of the full pack", ge=1e-3, le=1000)
    initial_charge: float = quantity(
        0.9, "1 full, 0 empty; from the next Reset on", ge=0, le=1
    )
    resistance_ohm: float = quantity(
        0.15, "internal resistance", jumps="battery", ge=0, le=10
    )
    idle_current_a: float = quantity(
        0.8, "current of the electronics", jumps="battery", ge=0, le=100
    )
    full_duty_current_a: float = quantity(
        1.5, "current of one wheel at full duty", jumps="battery", ge=0, le=100
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class RangeFinders:
    """Four range finders at the corners: the front ones look forward, the rear ones backward."""

    enabled: bool = True
    period_s: float = quantity(0.01, "period of its slice", jumps="fixed", gt=0)
    mount_x_m: float = quantity(
        0.20, "front sensors +x, rear ones -x", jumps="tof", gt=0, le=10
    )
    mount_y_m: float = quantity(
        0.12, "left sensors +y, right ones -y", jumps="tof", gt=0, le=10
    )
    field_of_view_rad: float = quantity(
        0.1745, "whole angle of the cone", jumps="tof", gt=0, lt=3.14
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Navigation:
    """Navigation tag (Pozyx in the thesis): rate and noise of an ultra-wideband system."""

    enabled: bool = False
    period_s: float = quantity(0.01, "period of its slice", jumps="fixed", gt=0)
    rate_hz: float = quantity(
        20.0,
        "sampling rate; its period must be a multiple of the slice",
        jumps="nav",
        ge=1e-3,
        le=10_000,
    )
    lever_arm_x_m: float = quantity(
        0.0, "tag in front of the centre of mass", jumps="nav", ge=-5, le=5
    )
    lever_arm_y_m: float = quantity(
        0.0, "tag left of the centre of mass", jumps="nav", ge=-5, le=5
    )
    latency_s: float = quantity(0.0, "age of the position", jumps="nav", ge=0, le=100)
    yaw_latency_s: float = quantity(0.0, "age of the yaw", jumps="nav", ge=0, le=100)
    white_noise_m: float = quantity(
        0.01, "white position noise, sd", jumps="nav", ge=0, le=10
    )
    correlated_noise_m: float = quantity(
        0.08, "correlated noise, sd", jumps="nav", ge=0, le=10
    )
    correlation_s: float = quantity(
        0.6, "correlation time, position", jumps="nav", gt=0, le=1000
    )
    yaw_noise_rad: float = quantity(
        0.0175, "correlated yaw noise, sd", jumps="nav", ge=0, le=3
    )
    yaw_correlation_s: float = quantity(
        2.0, "correlation time, yaw", jumps="nav", gt=0, le=1000
    )
