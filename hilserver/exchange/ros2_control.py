"""Parameters of diff_drive_controller and mecanum_drive_controller of ros2_control."""

from collections.abc import Iterator, Mapping
from math import nan
from pathlib import Path
from typing import Any, Final

import yaml

from hilserver.config.loading import nodes_of
from hilserver.errors import ConfigError
from hilserver.exchange.geometry import DriveGeometry
from hilserver.plant.units import RPM_PER_RAD_S

DIFFERENTIAL: Final = "diff_drive_controller"
MECANUM: Final = "mecanum_drive_controller"
PROJECTION: Final = "kinematics.sum_of_robot_center_projection_on_X_Y_axis"
RADIUS: Final = "kinematics.wheels_radius"
TURTLEBOT3: Final = "wheels.separation with wheels.radius (turtlebot3_node)"
OF_TURTLEBOT3: Final = {
    "wheels.separation": "wheel_separation",
    "wheels.radius": "wheel_radius",
}
FASTEST: Final = "linear.x.max_velocity"
HAS_FASTEST: Final = "linear.x.has_velocity_limits"  # of older versions
OFFSETS: Final = tuple(f"kinematics.base_frame_offset.{n}" for n in ("x", "y", "theta"))
Read = tuple[dict[str, Any], float | str, float]
Named = tuple[str, dict[str, object]]


def read(path: Path) -> Read:
    """Return plant keys, K_om and the difference of the radii; ConfigError if there are none."""
    found: dict[str, Read] = {}
    steering: list[str] = []
    for node, parameters in _nodes(nodes_of(path)):
        steered = [name for name in parameters if "steer" in name]
        steering += steered
        if steered:
            continue
        if "wheel_separation" in parameters and "wheel_radius" in parameters:
            found[node] = _differential(path, parameters)
        elif PROJECTION in parameters and RADIUS in parameters:
            found[node] = _mecanum(path, parameters)
        elif OF_TURTLEBOT3.keys() <= parameters.keys():
            known = {new: parameters[old] for old, new in OF_TURTLEBOT3.items()}
            found[node] = _differential(path, known)
    if steering and not found:
        raise ConfigError(
            f"{path}: '{steering[0]}' says that this robot steers its wheels; name the file of a"
            f" {DIFFERENTIAL} or {MECANUM}"
        )
    if not found:
        raise ConfigError(
            f"{path}: no ros__parameters have wheel_separation with wheel_radius ({DIFFERENTIAL}),"
            f" {RADIUS} with {PROJECTION.rpartition('.')[2]} ({MECANUM}) or {TURTLEBOT3}; name the"
            " file with the parameters of one of these"
        )
    first, *others = found
    for other in others:
        if found[other] != found[first]:
            raise ConfigError(
                f"{path}: describes two robots, {first} and {other}; leave the parameters of one"
            )
    return found[first]


def _nodes(root: yaml.Node | None, above: str = "") -> Iterator[Named]:
    """Yield name and parameters of each node, with dots for their groups.

    A name may be there twice, as in the files of TurtleBot3: ROS 2 takes both.
    """
    for name, inner in _entries(root):
        if name == "ros__parameters":
            yield above, dict(_flat(inner))
        elif isinstance(inner, yaml.MappingNode):
            yield from _nodes(inner, f"{above}/{name}".replace("//", "/"))


def _flat(group: yaml.Node, before: str = "") -> Iterator[tuple[str, object]]:
    for name, value in _entries(group):
        if isinstance(value, yaml.MappingNode):
            yield from _flat(value, f"{before}{name}.")
        else:
            yield f"{before}{name}", _scalar(value)


def _entries(node: yaml.Node | None) -> Iterator[tuple[str, yaml.Node]]:
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            yield str(key.value), value


def _scalar(node: yaml.Node) -> object:
    """Return a number as float, true or false as such, a list as its nodes, all else as a text."""
    kind = node.tag.rpartition(":")[2]
    if kind == "bool":
        return node.value.lower() in ("true", "yes", "on")
    if kind not in ("int", "float"):
        return node.value
    try:
        return float(node.value.lower().replace(".nan", "nan").replace(".inf", "inf"))
    except ValueError:
        return node.value


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
    limit = parameters.get(FASTEST, nan)
    is_limited = parameters.get(HAS_FASTEST, True) and limit == limit  # noqa: PLR0124 (NaN)
    if is_limited:
        fastest_m_s = _number(path, parameters, FASTEST, None)
        plant["max_rpm"] = fastest_m_s / mean_m * RPM_PER_RAD_S
    gain = "geometric_diff" if factor == 1.0 else 1.0 / (separation_m * factor)
    return plant, gain, 2.0 * (left - right) / (left + right)


def _mecanum(path: Path, parameters: Mapping[str, Any]) -> Read:
    # The controller knows the sum of half wheelbase and half track alone; so does the plant's
    # nominal K_om, and equal halves are as good as any.
    half_sum_m = _number(path, parameters, PROJECTION, None)
    other = next((n for n in OFFSETS if parameters.get(n, 0.0) != 0.0), None)
    if other is not None:
        raise ConfigError(
            f"{path}: {other} is {parameters[other]}: the wheels do not stand around base_link; set"
            " it to 0, and measure poses in the middle of the wheels"
        )
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
    separation_ratio = geometry.separation_m / track_m
    left_ratio = geometry.left_m / radius_m
    right_ratio = geometry.right_m / radius_m
    return f"""\
{DIFFERENTIAL}:
  ros__parameters:
    wheel_separation: {track_m!r}
    wheel_radius: {radius_m!r}
    wheel_separation_multiplier: {separation_ratio!r}
    left_wheel_radius_multiplier: {left_ratio!r}
    right_wheel_radius_multiplier: {right_ratio!r}
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
