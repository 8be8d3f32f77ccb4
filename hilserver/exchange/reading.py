"""A robot from the file of a controller (ROS 2 parameters) or from its URDF."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hilserver.errors import ConfigError
from hilserver.exchange import ros2_control, urdf


@dataclass(frozen=True, slots=True)
class DescribedRobot:
    """What a file says about a robot.

    Attributes
    ----------
    plant : dict
        Keys of the section `plant` of a configuration.
    rotation_gain : float or str
        `kinematics.rotation_gain`.
    wheel_radius_difference : float
        As the term of this name; a diagnosis begins with equal wheels and looks for it itself.
    """

    plant: dict[str, Any]
    rotation_gain: float | str
    wheel_radius_difference: float = 0.0

    def against(self, keys: Mapping[str, Any]) -> list[str]:
        """Return a line per number that is not used as it stands: other keys win over it."""
        own = {**self.plant, "rotation_gain": self.rotation_gain}
        lines = [
            f"{name} is {keys[name]} in the mapping, which holds, and {value} in the robot's file"
            for name, value in own.items()
            if name in keys and keys[name] != value
        ]
        if self.wheel_radius_difference:
            lines.append(
                f"the left radius is {self.wheel_radius_difference:.3%} larger than the right one"
                " in the robot's file; the diagnosis begins with equal wheels, to see whether the"
                " log shows this difference"
            )
        return lines


def read_robot(path: Path) -> DescribedRobot:
    """Read the dimensions of a robot; ConfigError says in one sentence why there are none."""
    if not path.exists():
        raise ConfigError(f"{path}: no such file; name a controller's YAML or a URDF")
    if path.suffix in (".yaml", ".yml"):
        return DescribedRobot(*ros2_control.read(path))
    if path.suffix in (".urdf", ".xml"):
        return DescribedRobot(*urdf.read(path))
    if path.suffix == ".xacro":
        raise ConfigError(urdf.is_xacro(path))
    raise ConfigError(
        f"{path}: is neither a controller's YAML nor a URDF; end its name in .yaml or .urdf"
    )
