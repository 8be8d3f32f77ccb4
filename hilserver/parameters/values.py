"""Reads the table's values from a robot and applies them; invalid ones are refused with a message.

A value is always a float; NaN means null.
"""

from collections.abc import Mapping
from dataclasses import replace
from math import isinf, isnan, nan
from typing import Any, Final

from hilserver.errors import meant
from hilserver.parameters.table import (
    BODY,
    EXCLUSIVE,
    GAIN,
    PLANT,
    SECTIONS,
    TERM,
    Parameter,
)
from hilserver.plant.errors import PlantError
from hilserver.plant.parameters import GEOMETRIC_GAINS, RobotParameters
from hilserver.plant.terms import complete, main_part

_PARTS: Final[Mapping[str, str]] = {
    section: section.partition(".")[2]
    for section in (*SECTIONS, "kinematics")
    if not section.startswith(BODY)
}
"""Part of `RobotParameters` that has the fields of a section; empty: itself."""


def named(name: str, table: Mapping[str, Parameter]) -> str:
    """Return the full name of a parameter; a bare cause means the first part of its term.

    PlantError if there is no such parameter.
    """
    if name in table:
        return name
    name = name.removeprefix("plant.") if name.startswith(f"plant.{TERM}") else name
    if name.startswith(TERM):
        return TERM + main_part(name.removeprefix(TERM))
    hint = meant(name, table, "docs/reference/parameters.md lists all names.")
    raise PlantError(f"{name:.100}: there is no such parameter: {hint}")


def check(parameter: Parameter, value: object) -> float:
    """Return a value as a float; `with_values` checks it against the others.

    PlantError if it is neither a number nor the name of one, out of range, or null without a
    meaning of null.
    """
    where = parameter.name
    if value is None:
        value = nan
    if isinstance(value, bool) and parameter.is_flag:
        value = float(value)
    if isinstance(value, str) and parameter.names:
        known = dict(parameter.names)
        if value not in known:
            raise PlantError(f"{where}: {value!r:.60} is none of {', '.join(known)}.")
        value = known[value]
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise PlantError(f"{where}: must be a number, not {value!r:.60}.")
    if parameter.when == "restart":
        raise PlantError(f"{where}: needs a restart; change it in config.yaml.")
    try:
        number = float(value)
    except OverflowError:
        raise PlantError(f"{where}: is outside {parameter.range_text}.") from None
    if isnan(number):
        if not parameter.nullable:
            raise PlantError(f"{where}: must be a finite number; it cannot be null.")
        return number
    if isinf(number) or not parameter.low <= number <= parameter.high:
        raise PlantError(f"{where}: {number:g} is outside {parameter.range_text}.")
    if parameter.is_flag and not number.is_integer():
        raise PlantError(f"{where}: must be 0 or 1, not {number:g}.")
    return number


def read(robot: RobotParameters) -> dict[str, float]:
    """Return a robot's values of the plant's parameters that can change at a tick."""
    terms = complete(robot.terms)
    found: dict[str, float] = {}
    for name in PLANT:
        section, _, key = name.rpartition(".")
        if name.startswith(TERM):
            value: Any = terms[name.removeprefix(TERM)]
        elif name == GAIN:
            value = None if robot.rotation_gain in GEOMETRIC_GAINS else robot.k_om
        elif section in _PARTS:
            part = getattr(robot, _PARTS[section]) if _PARTS[section] else robot
            value = getattr(part, key)
        else:
            continue
        found[name] = nan if value is None else float(value)
    return found


def geometric_gain(robot: RobotParameters) -> str:
    """Return the name that null stands for in the robot's `kinematics.rotation_gain`."""
    gain = robot.rotation_gain
    return str(gain) if gain in GEOMETRIC_GAINS else GEOMETRIC_GAINS[0]


def with_values(
    robot: RobotParameters,
    values: Mapping[str, float],
    geometric_gain: str = GEOMETRIC_GAINS[0],
) -> RobotParameters:
    """Return the robot with other values, checked together except for the checks of `packing.pack`.

    PlantError if the robot cannot run with them: one sentence that names the parameter.

    Parameters
    ----------
    values : mapping of float
        By full name; each as returned by `check`.
    geometric_gain : str
        Name that null stands for in `kinematics.rotation_gain`.
    """
    changes: dict[str, dict[str, Any]] = {}
    for name, value in values.items():
        section, _, key = name.rpartition(".")
        part = "terms" if name.startswith(TERM) else _PARTS[section]
        key = name.removeprefix(TERM) if part == "terms" else key
        changes.setdefault(part, {})[key] = _plain(name, value, geometric_gain)
    own = changes.pop("", {})
    if "terms" in changes:
        own["terms"] = complete(robot.terms) | changes.pop("terms")
    for part, fields in changes.items():
        own[part] = replace(getattr(robot, part), **fields)
    return replace(robot, **own)


def _plain(name: str, value: float, geometric_gain: str) -> Any:
    if isnan(value):
        return geometric_gain if name == GAIN else None
    if name == EXCLUSIVE:
        return bool(value)
    if name.endswith("yaw_sign") and value.is_integer():
        return int(value)
    return value
