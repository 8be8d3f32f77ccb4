"""How the drive is enabled again after a silence of the host.

The real device asks for its service. Where a command is enough, the host must have asked for rest
once since the silence, so that what it went on sending meanwhile moves nothing by itself.
"""

from enum import Enum, auto

from hilserver.ros.incoming import MOVING, Values, is_at_rest


class Way(Enum):
    """Where the host stands on its way back."""

    OPEN = auto()  # nothing was withdrawn
    WITHDRAWN = auto()
    RESTED = auto()


class WayBack:
    """Knows whether a command may enable the drive; a Stop or a fault is none of its business."""

    def __init__(self, *, command_enables: bool) -> None:
        self._command_enables, self._way = command_enables, Way.OPEN

    def withdraw(self) -> None:
        """Note that silence has disabled the drive."""
        if self._command_enables and self._way is not Way.RESTED:
            self._way = Way.WITHDRAWN

    def forget(self) -> None:
        """Note that somebody else decided about enable, or that the robot is in the safe state."""
        self._way = Way.OPEN

    def enables(self, values: Values) -> bool:
        """Take a command of the host; return whether it enables the drive."""
        if self._way is Way.OPEN or MOVING.isdisjoint(values):
            return False
        if self._way is Way.RESTED:
            self._way = Way.OPEN
            return True
        if is_at_rest(values):
            self._way = Way.RESTED
        return False
