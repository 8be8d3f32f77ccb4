"""The machine of a log: the configured one, with what the mapping file says about it."""

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any

from hilserver.config.root import Config
from hilserver.errors import LogError
from hilserver.measured.data import MeasuredLog
from hilserver.measured.thresholds import ODD_TIMES
from hilserver.plant.errors import PlantError
from hilserver.plant.parameters import RobotParameters


def machine(log: MeasuredLog, robot: RobotParameters) -> RobotParameters:
    """Return the plant of a log, whose wheels its drive turns: a replay has no body.

    Raises
    ------
    LogError
        If the mapping's machine does not fit the rest of the configured one.
    """
    names = {item.name for item in fields(robot)}
    given: dict[str, Any] = {
        key: value for key, value in log.plant.items() if key in names
    }
    for key in ("controller", "process"):
        if isinstance(given.get(key), Mapping):
            given[key] = replace(getattr(robot, key), **given[key])
    try:
        return replace(robot, **given, body_wheels=False)
    except PlantError as error:
        raise LogError(
            f"{log.sources[0].file}: plant section of its mapping: {error}"
        ) from None


def doubts(robot: RobotParameters) -> list[str]:
    """Return a question for each dimension that may be in another unit."""
    found = []
    for name, value_m in (
        ("track (wheel separation)", robot.track_m),
        ("wheelbase", robot.wheelbase_m),
    ):
        if value_m is None:
            continue
        times = value_m / robot.wheel_radius_m
        if not 1.0 <= times <= ODD_TIMES:
            found.append(
                f"the {name} is {value_m:g} m and the wheel radius {robot.wheel_radius_m:g} m:"
                f" {times:.3g} times as much; are both in metres?"
            )
    return found


def machine_config(log: MeasuredLog, config: Config) -> Config:
    """Return the configuration with the plant of a log."""
    keys: dict[str, Any] = dict(log.plant)
    gain = keys.pop("rotation_gain", config.kinematics.rotation_gain)
    given = config.plant.model_dump(exclude_unset=True)
    for key in ("controller", "process"):
        if key in keys:
            keys[key] = {**given.get(key, {}), **keys[key]}
    plant = type(config.plant).model_validate({**given, **keys})
    return config.changed(plant=plant, kinematics={"rotation_gain": gain})
