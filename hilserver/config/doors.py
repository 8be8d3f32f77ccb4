"""Doors that know no log-in, and what everyone behind them may do.

Whoever gives no name has the role ``opcua.anonymous``, whichever door it is: an engineer as long
as no users are named, nobody once they are. A door without a log-in (Foxglove, ROS 2, S7, the
databus) cannot tell people apart, so it has the rights of that role, unless its section `grants`
others by name.

Connections that we open to what the configuration names (`peers`, the shield's line) are granted by
their section. `hilserver.daemon.doors` prints all of them as one table.
"""

from enum import StrEnum
from typing import Final, Literal, NamedTuple

from hilserver.opcua.settings import Role

Grant = Literal["measured", "command"]
Ros2Grant = Literal["measured", "command", "parameters"]
GRANTS: Final = (
    "What everyone there may do: write measured.*, command; null: as opcua.anonymous, so nothing"
    " once opcua.users are named"
)


class Right(StrEnum):
    """What one may do besides watching."""

    MEASURED = "measured"
    COMMAND = "command"
    PARAMETERS = "parameters"
    ADMINISTER = "administer"


WRITING: Final = frozenset({Right.MEASURED, Right.COMMAND})
_OF_ROLE: Final = {
    None: frozenset[Right](),
    Role.OBSERVER: frozenset[Right](),
    Role.OPERATOR: WRITING,
    Role.ENGINEER: WRITING | {Right.PARAMETERS},
}


class DoorRule(NamedTuple):
    """A door without a log-in."""

    title: str  # for people
    source: str  # name under which it writes
    key: str  # that grants rights
    is_open: bool
    usual: frozenset[Right]  # while everyone is an engineer
    grants: tuple[Grant | Ros2Grant, ...] | None
    stranger: Role | None = Role.ENGINEER  # role of whoever gives no name; None: none

    @property
    def rights(self) -> frozenset[Right]:
        """What everyone there may do."""
        if self.grants is not None:
            return frozenset(map(Right, self.grants))
        return self.usual & _OF_ROLE[self.stranger]

    @property
    def lost(self) -> tuple[Right, ...]:
        """What it would allow if no users were named, and its section does not decide."""
        if self.grants is not None:
            return ()
        return tuple(right for right in Right if right in self.usual - self.rights)

    @property
    def way_out(self) -> str:
        """How the configuration gives it back what it has lost."""
        return f"{self.key}: [{', '.join(self.lost)}]"
