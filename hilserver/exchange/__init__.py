"""What was found, in the files of other programs: ROS 2, URDF, SDF, MATLAB.

The same files describe the robot to begin with.
"""

from hilserver.exchange.reading import DescribedRobot, read_robot
from hilserver.exchange.writing import (
    FORMATS,
    WRITTEN,
    FoundTerm,
    RobotAnswer,
    files_for,
)

__all__ = [
    "FORMATS",
    "WRITTEN",
    "DescribedRobot",
    "FoundTerm",
    "RobotAnswer",
    "files_for",
    "read_robot",
]
