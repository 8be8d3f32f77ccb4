"""Every cause with its reference size, how it is drawn, and what a right answer to it is."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from hilserver_injector.recipe import Recipe

Draw = Callable[[np.random.Generator, float], dict[str, float]]


@dataclass(frozen=True, slots=True)
class Cause:
    """One cause of the vocabulary.

    Attributes
    ----------
    kind : str
        Log it shows in: drive, bench, or drive on mecanum wheels.
    size : float
        Reference size of `parameter`.
    signed : bool
        True: the sign is drawn.
    base : float
        Null value, to which the size is added (or from which it leads away).
    required : bool
        True: it must be named at the reference size; others are extra.
    shape : callable or None
        Draws the other parameters of the cause.
    """

    name: str
    kind: str
    parameter: str
    size: float
    signed: bool = True
    base: float = 0.0
    required: bool = True
    shape: Draw | None = None

    def draw(self, rng: np.random.Generator, scale: float = 1.0) -> dict[str, float]:
        """Return the parameters of one appearance, `scale` times the reference size."""
        sign = float(rng.choice([-1.0, 1.0])) if self.signed else 1.0
        if self.name == "setpoint_rate_limit":
            return {self.parameter: self.size / scale}
        values = {self.parameter: self.base + sign * scale * (self.size - self.base)}
        if self.name == "controller_gains":
            values = {self.parameter: max(self.size * scale, -0.8)}
        return values | (self.shape(rng, scale) if self.shape else {})


def _half_floor(rng: np.random.Generator, scale: float) -> dict[str, float]:
    axis, edge = rng.choice(["x", "y"]), rng.choice(["min", "max"])
    region = {"x_min": -1000.0, "x_max": 1000.0, "y_min": -1000.0, "y_max": 1000.0}
    region[f"{axis}_{edge}"] = float(rng.uniform(-0.5, 0.5))
    return {f"surface_change.{key}": value for key, value in region.items()}


def _lever(rng: np.random.Generator, scale: float) -> dict[str, float]:
    turn = rng.uniform(-math.pi, math.pi)
    size = 0.08 * scale
    return {
        "nav_lever_arm.x": size * math.cos(turn),
        "nav_lever_arm.y": size * math.sin(turn),
    }


def _slope(rng: np.random.Generator, scale: float) -> dict[str, float]:
    turn = rng.uniform(-math.pi, math.pi)
    return {
        "floor_slope.x": 0.02 * scale * math.cos(turn),
        "floor_slope.y": 0.02 * scale * math.sin(turn),
    }


def _phase(name: str) -> Draw:
    return lambda rng, scale: {name: float(rng.uniform(-math.pi, math.pi))}


def _fixed(name: str, value: float) -> Draw:
    return lambda rng, scale: {name: value}


_TABLE = (
    Cause("rotation_gain", "drive", "rotation_gain", 0.03),
    Cause("wheel_radius", "drive", "wheel_radius", 0.04),
    Cause("wheel_radius_difference", "drive", "wheel_radius_difference", 0.02),
    Cause("rotation_gain_speed", "drive", "rotation_gain_speed", 0.2),
    Cause("longitudinal_slip", "drive", "longitudinal_slip", 0.12, signed=False),
    Cause("side_slip", "drive", "side_slip", 0.15),
    Cause("icr_offset", "drive", "icr_offset", 0.06),
    Cause("wheel_misalignment", "drive", "wheel_misalignment", 0.03),
    Cause("nav_frame_yaw", "drive", "nav_frame_yaw", 0.05),
    Cause("nav_latency", "drive", "nav_latency", 0.1, signed=False),
    Cause("yaw_latency", "drive", "yaw_latency", 0.15, signed=False),
    Cause("imu_latency", "drive", "imu_latency", 0.05, signed=False),
    Cause("gyro_bias", "drive", "gyro_bias", 0.006),
    Cause("gyro_scale", "drive", "gyro_scale", 0.03),
    Cause("nav_scale", "drive", "nav_scale", 0.04),
    Cause("nav_lever_arm", "drive", "nav_lever_arm.x", 0.08, shape=_lever),
    Cause("floor_slope", "drive", "floor_slope.x", 0.02, shape=_slope),
    Cause(
        "nav_outliers", "drive", "nav_outliers.share", 0.03, signed=False,
        shape=_fixed("nav_outliers.size", 1.5),
    ),
    Cause("surface_change", "drive", "surface_change.k_om", 0.3, shape=_half_floor),
    Cause(
        "heading_distortion", "drive", "heading_distortion.a1", 0.1, signed=False,
        shape=_phase("heading_distortion.phase1"),
    ),
    Cause("rotation_gain_radius", "drive", "rotation_gain_radius", 0.2),
    Cause("actuation_delay", "drive", "actuation_delay", 0.04, signed=False),
    Cause("setpoint_rate_limit", "drive", "setpoint_rate_limit", 150.0, signed=False),
    Cause("saturation_limit", "drive", "saturation_limit", 55.0, signed=False, base=100.0),
    Cause("battery_sag", "drive", "battery_sag", 1.0, signed=False),
    Cause("coulomb_friction", "bench", "coulomb_friction", 1.5, signed=False),
    Cause("dead_zone", "bench", "dead_zone", 2.0, signed=False),
    Cause("viscous_load", "bench", "viscous_load", 0.05, signed=False),
    Cause("process_gain", "bench", "process_gain", 0.05),
    Cause("time_constant", "bench", "time_constant", 0.2),
    Cause(
        "stribeck_friction", "bench", "stribeck_friction.f_s", 4.0, signed=False,
        shape=_fixed("stribeck_friction.n_s", 6.0),
    ),
    Cause(
        "wheel_load", "bench", "wheel_load.f", 3.0, signed=False,
        shape=lambda rng, scale: {"wheel_load.wheel": float(rng.integers(0, 4))},
    ),
    Cause(
        "encoder_scale", "drive", "encoder_scale.a", 0.05,
        shape=lambda rng, scale: {"encoder_scale.wheel": float(rng.integers(0, 4))},
    ),
    Cause("control_period", "bench", "control_period", 0.01, signed=False, base=0.001),
    Cause("controller_gains", "bench", "controller_gains.p", -0.3, signed=False),
    Cause("encoder_filter", "bench", "encoder_filter", 0.01, signed=False),
    Cause("encoder_quantization", "bench", "encoder_quantization", 0.5, signed=False),
    # not among the reference sizes
    Cause("traction_slip", "drive", "traction_slip", 0.1, signed=False, required=False),
    Cause("body_lag", "drive", "body_lag", 0.1, signed=False, required=False),
    Cause("acceleration_slip", "drive", "acceleration_slip", 0.08, signed=False, required=False),
    Cause(
        "wheel_runout", "drive", "wheel_runout.amplitude", 0.04, signed=False, required=False,
        shape=_phase("wheel_runout.phase"),
    ),
    Cause(
        "friction_anisotropy", "drive", "friction_anisotropy.ratio", 1.6, signed=False, base=1.0,
        required=False,
    ),
    Cause(
        "nav_position_bias", "drive", "nav_position_bias.amplitude", 0.2, signed=False,
        required=False, shape=_fixed("nav_position_bias.wavelength", 5.0),
    ),
    Cause("backlash", "drive", "backlash", 0.2, signed=False, required=False),
    Cause("roller_slip", "mecanum", "roller_slip", 0.1, signed=False, required=False),
)  # fmt: skip
CAUSES: Mapping[str, Cause] = {cause.name: cause for cause in _TABLE}
REQUIRED = tuple(cause.name for cause in _TABLE if cause.required)

TWINS: tuple[frozenset[str], ...] = (
    frozenset({"icr_offset", "nav_lever_arm"}),
    frozenset({"wheel_misalignment", "nav_frame_yaw"}),
    frozenset({"wheel_radius", "nav_scale"}),
    frozenset({"traction_slip", "nav_scale"}),
    frozenset({"process_gain", "saturation_limit"}),
    frozenset({"coulomb_friction", "dead_zone"}),
)
"""Causes that many logs cannot tell apart; not drawn together as a pair."""


def single(name: str, seed: int, scale: float = 1.0) -> Recipe:
    """Return the recipe of a log with one cause at `scale` times its reference size."""
    cause = CAUSES[name]
    recipe = Recipe(kind="bench" if cause.kind == "bench" else "drive", seed=seed)
    if cause.kind == "mecanum":
        recipe = replace(recipe, drive="mecanum", manoeuvre="omni")
    return replace(recipe, causes=cause.draw(recipe.generator(f"cause {name}"), scale))


def nothing(kind: str, seed: int) -> Recipe:
    """Return the recipe of a log with nothing hidden."""
    return Recipe(kind="drive" if kind == "drive" else "bench", seed=seed)
