"""60 recordings without an effect, and 36 with one term at its reference size."""

from dataclasses import dataclass

from tests.diagnosis.own_recordings.recordings import Drive, RealDrive, Rows

SECONDS = 50.0
ROWS = {
    "1 kHz, the recorder's own": Rows(whole=True),
    "1 kHz": Rows(),
    "1 kHz, under way": Rows(first=13_007),
    "1 kHz, navigation empty": Rows(nav_empty=True),
    "100 Hz": Rows(10),
    "100 Hz, between the sensors' runs": Rows(10, 7),
    "50 Hz": Rows(20),
    "50 Hz, navigation empty": Rows(20, nav_empty=True),
    "50 Hz, under way": Rows(20, 13_007),
    "33 ms": Rows(33, 5),
}
DROVE = {
    "wheels, noise": Drive("wheels", SECONDS, 1),
    "body, no noise": Drive("twist", SECONDS, 2, noisy=False),
    "wheels as a curve, no noise": Drive("wheel curve", SECONDS, 3, noisy=False),
    "body as a curve, noise": Drive("twist curve", SECONDS, 4),
    "real time, demonstration, noise": RealDrive(None, SECONDS, 5),
    "real time, wheels, no noise": RealDrive("wheels", SECONDS, 6, noisy=False),
}


@dataclass(frozen=True)
class Hidden:
    """A term at its reference size, and the drive that shows it."""

    cause: str
    drive: Drive
    rows: Rows


def _hidden(cause: str, terms: dict[str, float], number: int) -> Hidden:
    bench = cause in BENCH
    drive = Drive(
        "bench" if bench else "long",
        120.0 if bench else 360.0,
        10 + number,
        True,
        terms,
    )
    return Hidden(cause, drive, Rows(whole=True))


DRIVEN = {
    "rotation_gain": {"rotation_gain": 0.03},
    "wheel_radius": {"wheel_radius": 0.04},
    "wheel_radius_difference": {"wheel_radius_difference": 0.02},
    "rotation_gain_speed": {"rotation_gain_speed": 0.2},
    "longitudinal_slip": {"longitudinal_slip": 0.12},
    "side_slip": {"side_slip": 0.15},
    "icr_offset": {"icr_offset": 0.06},
    "wheel_misalignment": {"wheel_misalignment": 0.03},
    "nav_frame_yaw": {"nav_frame_yaw": 0.05},
    "nav_latency": {"nav_latency": 0.1},
    "yaw_latency": {"yaw_latency": 0.15},
    "imu_latency": {"imu_latency": 0.05},
    "gyro_bias": {"gyro_bias": 0.006},
    "gyro_scale": {"gyro_scale": 0.03},
    "nav_scale": {"nav_scale": 0.04},
    "nav_lever_arm": {"nav_lever_arm.x": 0.08},
    "floor_slope": {"floor_slope.x": 0.02},
    "nav_outliers": {"nav_outliers.share": 0.03, "nav_outliers.size": 1.5},
    "surface_change": {"surface_change.k_om": 0.3, "surface_change.x_min": 0.2},
    "heading_distortion": {
        "heading_distortion.a1": 0.1,
        "heading_distortion.phase1": 0.7,
    },
    "rotation_gain_radius": {"rotation_gain_radius": 0.2},
    "actuation_delay": {"actuation_delay": 0.04},
    "setpoint_rate_limit": {"setpoint_rate_limit": 150.0},
    "saturation_limit": {"saturation_limit": 55.0},
    "battery_sag": {"battery_sag": 1.0},
}
BENCH = {
    "coulomb_friction": {"coulomb_friction": 1.5},
    "dead_zone": {"dead_zone": 2.0},
    "viscous_load": {"viscous_load": 0.05},
    "process_gain": {"process_gain": 0.05},
    "time_constant": {"time_constant": 0.2},
    "stribeck_friction": {"stribeck_friction.f_s": 4.0, "stribeck_friction.n_s": 6.0},
    "wheel_load": {"wheel_load.f": 3.0, "wheel_load.wheel": 1.0},
    "control_period": {"control_period": 0.01},
    "controller_gains": {"controller_gains.p": -0.3},
    "encoder_filter": {"encoder_filter": 0.01},
    "encoder_quantization": {"encoder_quantization": 0.5},
}
HIDDEN = [_hidden(*one, number) for number, one in enumerate((DRIVEN | BENCH).items())]
