"""Parameters of diff_drive_controller and mecanum_drive_controller of ros2_control."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from pydantic import RootModel

from hilserver.config.loading import load
from hilserver.errors import ConfigError
from hilserver.exchange.geometry import DriveGeometry
from hilserver.plant.units import RPM_PER_RAD_S

DIFFERENTIAL: Final = "diff_drive_controller"
MECANUM: Final = "mecanum_drive_controller"
PROJECTION: Final = "kinematics.sum_of_robot_center_projection_on_X_Y_axis"
RADIUS: Final = "kinematics.wheels_radius"
Read = tuple[dict[str, Any], float | str, float]


class _Nodes(RootModel[dict[str, Any]]):
    """A file of ROS 2 parameters."""


def read(path: Path) -> Read:
    """Return plant keys, K_om and the difference of the radii; ConfigError if there are none."""
    for parameters in _parameters(load(path, _Nodes).root):
        steered = next((name for name in parameters if "steer" in name), None)
        if steered is not None:
            raise ConfigError(
                f"{path}: '{steered}' says that this robot steers its wheels; name the file of a"
                f" {DIFFERENTIAL} or {MECANUM}"
            )
        if "wheel_separation" in parameters and "wheel_radius" in parameters:
            return _differential(path, parameters)
        if PROJECTION in parameters and RADIUS in parameters:
            return _mecanum(path, parameters)
    raise ConfigError(
        f"{path}: no ros__parameters have wheel_separation with wheel_radius ({DIFFERENTIAL}) or"
        f" {RADIUS} with {PROJECTION.rpartition('.')[2]} ({MECANUM}); name the file with"
        " the parameters of one of these controllers"
    )


def _parameters(node: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the parameters of each node, with dots for their groups."""
    for name, inner in node.items():
        if not isinstance(inner, dict):
            continue
        if name == "ros__parameters":
            yield dict(_flat(inner))
        else:
            yield from _parameters(inner)


def _flat(group: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in group.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{before}{name}.")
        else:
            yield f"{before}{name}", value


def _number(
    path: Path, parameters: Mapping[str, Any], name: str, default: Any
) -> float:
    value = parameters.get(name, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not value > 0:
        raise ConfigError(
            f"{path}: {name}: must be a number above 0, not {value!r:.60}"
        )
    return float(value)


def _differential(path: Path, parameters: Mapping[str, Any]) -> Read:
    separation_m = _number(path, parameters, "wheel_separation", None)
    factor = _number(path, parameters, "wheel_separation_multiplier", 1.0)
    radius_m = _number(path, parameters, "wheel_radius", None)
    left = _number(path, parameters, "left_wheel_radius_multiplier", 1.0)
    right = _number(path, parameters, "right_wheel_radius_multiplier", 1.0)

    mean_m = radius_m * (left + right) / 2.0
    plant: dict[str, Any] = {
        "wheel_radius_m": mean_m,
        "track_m": separation_m,
        "wheelbase_m": None,
        "icr_offset_m": 0.0,
    }
    if "linear.x.max_velocity" in parameters:
        fastest_m_s = _number(path, parameters, "linear.x.max_velocity", None)
        plant["max_rpm"] = fastest_m_s / mean_m * RPM_PER_RAD_S
    gain = "geometric_diff" if factor == 1.0 else 1.0 / (separation_m * factor)
    return plant, gain, 2.0 * (left - right) / (left + right)


def _mecanum(path: Path, parameters: Mapping[str, Any]) -> Read:
    # The controller knows the sum of half wheelbase and half track alone; so does the plant's
    # nominal K_om, and equal halves are as good as any.
    half_sum_m = _number(path, parameters, PROJECTION, None)
    plant = {
        "drive": "mecanum",
        "wheel_radius_m": _number(path, parameters, RADIUS, None),
        "track_m": half_sum_m,
        "wheelbase_m": half_sum_m,
        "icr_offset_m": 0.0,
    }
    return plant, "geometric_skid", 0.0


def differential_text(geometry: DriveGeometry, radius_m: float, track_m: float) -> str:
    """Return the parameters that give a controller this geometry, as multipliers."""
    return f"""\
{DIFFERENTIAL}:
  ros__parameters:
    wheel_separation: {track_m!r}
    wheel_radius: {radius_m!r}
    wheel_separation_multiplier: {geometry.separation_m / track_m!r}
    left_wheel_radius_multiplier: {geometry.left_m / radius_m!r}
    right_wheel_radius_multiplier: {geometry.right_m / radius_m!r}
"""


def mecanum_text(geometry: DriveGeometry) -> str:
    """Return the parameters that give a controller this geometry; it has one radius."""
    # om = (r - l)/(2 k) with k the sum of the half distances
    return f"""\
{MECANUM}:
  ros__parameters:
    kinematics:
      base_frame_offset: {{x: 0.0, y: 0.0, theta: 0.0}}
      wheels_radius: {geometry.radius_m!r}
      sum_of_robot_center_projection_on_X_Y_axis: {geometry.separation_m / 2.0!r}
"""
