"""The true machine's constants: nominal values of the robot, changed by what is hidden in it."""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from hilserver_injector.recipe import WHEELS

Array = NDArray[np.float64]

WHEELBASE_M, TRACK_M, RADIUS_M, ICR_M = 0.25, 0.31, 0.085, 0.02
K_OM = TRACK_M / (WHEELBASE_M**2 + TRACK_M**2)
YAW_SIGN = -1.0
KP, KI, GAIN, T1_S, T2_S = 13.513, 195.84, 1.11, 0.069, 0.0023
NEVER = 1e9
MECANUM_RADIUS_M, MECANUM_K_OM = 0.05, 1.0 / (0.25 + 0.36)

NOMINAL: Mapping[str, float] = {
    "control_s": 0.001,
    "kp": KP,
    "ki": KI,
    "tracking": math.sqrt(KI),
    "limit": 100.0,
    "gain": GAIN,
    "t1": T1_S,
    "t2": T2_S,
    "viscous": 0.0,
    "dead_zone": 0.0,
    "coulomb": 0.0,
    "stribeck": 0.0,
    "stribeck_rpm": 6.0,
    "load_fl": 0.0,
    "load_rl": 0.0,
    "load_fr": 0.0,
    "load_rr": 0.0,
    "sag": 0.0,
    "delay_s": 0.0,
    "rate": NEVER,
    "shown_fl": 1.0,
    "shown_rl": 1.0,
    "shown_fr": 1.0,
    "shown_rr": 1.0,
    "filter_s": 0.0,
    "quantum": 0.0,
    "backlash": 0.0,
    "radius_left": RADIUS_M,
    "radius_right": RADIUS_M,
    "k_om": YAW_SIGN * K_OM,
    "gain_speed": 0.0,
    "gain_radius": 0.0,
    "traction": 0.0,
    "rollers": 0.0,
    "lag_s": 0.0,
    "slip": 0.0,
    "accel_slip": 0.0,
    "side_slip": 0.0,
    "icr": ICR_M,
    "misalign": 0.0,
    "slope_x": 0.0,
    "slope_y": 0.0,
    "surface_k": 1.0,
    "surface_v": 1.0,
    "x_min": 0.0,
    "x_max": 1000.0,
    "y_min": -1000.0,
    "y_max": 1000.0,
    "runout": 0.0,
    "runout_phase": 0.0,
    "tyres": 0.0,
    "tyre_ratio": 1.0,
    "tyre_offset": 0.0,
    "tyre_inertia": 0.0,
    "drag_turn": 0.0,
    "drag_speed": 0.0,
    "drag_phase": 0.0,
    "talk": 0.0,
    "talk_from": 0.0,
    "talk_to": 1.0,
    "wave_turn": 0.0,
    "wave_duty": 0.0,
    "wave_period": 10.0,
    "wave_phase": 0.0,
    "memory": 0.0,
    "charge": 0.8,
}
"""Every constant of the machine by name; zero where nothing is hidden."""

RECORD = np.dtype([(name, "f8") for name in NOMINAL])
LOAD, SHOWN = (list(NOMINAL).index(name) for name in ("load_fl", "shown_fl"))

_PLAIN = {
    "saturation_limit": "limit",
    "coulomb_friction": "coulomb",
    "viscous_load": "viscous",
    "dead_zone": "dead_zone",
    "stribeck_friction.f_s": "stribeck",
    "stribeck_friction.n_s": "stribeck_rpm",
    "battery_sag": "sag",
    "actuation_delay": "delay_s",
    "setpoint_rate_limit": "rate",
    "control_period": "control_s",
    "encoder_filter": "filter_s",
    "encoder_quantization": "quantum",
    "backlash": "backlash",
    "rotation_gain_speed": "gain_speed",
    "rotation_gain_radius": "gain_radius",
    "traction_slip": "traction",
    "body_lag": "lag_s",
    "longitudinal_slip": "slip",
    "acceleration_slip": "accel_slip",
    "side_slip": "side_slip",
    "wheel_misalignment": "misalign",
    "floor_slope.x": "slope_x",
    "floor_slope.y": "slope_y",
    "surface_change.x_min": "x_min",
    "surface_change.x_max": "x_max",
    "surface_change.y_min": "y_min",
    "surface_change.y_max": "y_max",
    "wheel_runout.amplitude": "runout",
    "wheel_runout.phase": "runout_phase",
    "friction_anisotropy.ratio": "tyre_ratio",
    "friction_anisotropy.offset": "tyre_offset",
    "friction_anisotropy.inertia": "tyre_inertia",
    "cable_drag.turn": "drag_turn",
    "cable_drag.speed": "drag_speed",
    "cable_drag.phase": "drag_phase",
    "cross_talk.share": "talk",
    "cross_talk.from": "talk_from",
    "cross_talk.to": "talk_to",
    "periodic.turn": "wave_turn",
    "periodic.duty": "wave_duty",
    "periodic.period": "wave_period",
    "periodic.phase": "wave_phase",
    "hysteresis": "memory",
}
_RELATIVE = {
    "process_gain": ("gain",),
    "time_constant": ("t1",),
    "controller_gains.p": ("kp",),
    "controller_gains.i": ("ki",),
    "wheel_radius": ("radius_left", "radius_right"),
    "rotation_gain": ("k_om",),
    "surface_change.k_om": ("surface_k",),
    "surface_change.v": ("surface_v",),
}


def machine(causes: Mapping[str, float], charge: float, drive: str = "skid") -> Array:
    """Return the constants of the machine with these causes, in the order of `NOMINAL`.

    Parameters
    ----------
    causes : mapping of str to float
        ``cause`` or ``cause.part``; what belongs to sensors and data is left alone.
    charge : float
        Charge of the battery at the start, 0 .. 1.
    """
    values = dict(NOMINAL)
    values["charge"] = charge
    if drive == "mecanum":
        values |= {
            "radius_left": MECANUM_RADIUS_M,
            "radius_right": MECANUM_RADIUS_M,
            "icr": 0.0,
        }
        values |= {"k_om": YAW_SIGN * MECANUM_K_OM, "rollers": 1.0}
    values["rollers"] *= 1.0 - causes.get("roller_slip", 0.0)
    for name, value in causes.items():
        if name in _PLAIN:
            values[_PLAIN[name]] = value
        for key in _RELATIVE.get(name, ()):
            values[key] *= 1.0 + value
    difference = causes.get("wheel_radius_difference", 0.0)
    values["radius_left"] *= 1.0 + difference / 2.0
    values["radius_right"] *= 1.0 - difference / 2.0
    values["icr"] += causes.get("icr_offset", 0.0)
    if "wheel_load.f" in causes:
        wheel = WHEELS[int(causes.get("wheel_load.wheel", 0))]
        values[f"load_{wheel}"] = causes["wheel_load.f"]
    if "encoder_scale.a" in causes:
        wheel = WHEELS[int(causes.get("encoder_scale.wheel", 0))]
        values[f"shown_{wheel}"] = 1.0 + causes["encoder_scale.a"]
    if any(name.startswith("friction_anisotropy") for name in causes):
        values["tyres"] = 1.0
    return np.array([values[name] for name in NOMINAL])
