"""The state machine as a table: which state follows a command, or that it is refused.

`Control` executes the table; ``docs/reference/states.md`` prints it.
"""

from collections.abc import Mapping
from enum import StrEnum
from typing import Final

from hilserver.errors import ControlRefused
from hilserver.signals import State


class Command(StrEnum):
    """What moves the state machine: methods first, then actions of the daemon itself."""

    START = "Start"
    PAUSE = "Pause"
    STEP = "Step"
    STOP = "Stop"
    RESET = "Reset"
    LOAD_SNAPSHOT = "LoadSnapshot"
    STARTED = "started"
    FAULT = "fault"
    END = "end"


_STARTING, _RUNNING, _PAUSED, _SAFE, _STOPPING = State
_REFUSED = None

# fmt: off
TRANSITIONS: Final[Mapping[Command, tuple[State | None, ...]]] = {
    # in state:             starting   running    paused     safe       stopping
    Command.START:         (_REFUSED,  _RUNNING,  _RUNNING,  _REFUSED,  _REFUSED),
    Command.PAUSE:         (_REFUSED,  _PAUSED,   _PAUSED,   _REFUSED,  _REFUSED),
    Command.STEP:          (_REFUSED,  _REFUSED,  _PAUSED,   _REFUSED,  _REFUSED),
    Command.STOP:          (_SAFE,     _SAFE,     _SAFE,     _SAFE,     _REFUSED),
    Command.RESET:         (_REFUSED,  _RUNNING,  _PAUSED,   _RUNNING,  _REFUSED),
    Command.LOAD_SNAPSHOT: (_REFUSED,  _RUNNING,  _PAUSED,   _REFUSED,  _REFUSED),
    Command.STARTED:       (_RUNNING,  _RUNNING,  _PAUSED,   _SAFE,     _STOPPING),
    Command.FAULT:         (_SAFE,     _SAFE,     _SAFE,     _SAFE,     _STOPPING),
    Command.END:           (_STOPPING, _STOPPING, _STOPPING, _STOPPING, _STOPPING),
}
# fmt: on


def next_state(state: State, command: Command) -> State:
    """Return the state that follows `command`.

    ControlRefused if the command is refused in `state`; names the states in which it works.
    """
    following = TRANSITIONS[command][state]
    if following is None:
        allowed = [s.word for s in State if TRANSITIONS[command][s] is not None]
        raise ControlRefused(
            f"{command} is not possible in state {state.word}, only in state {' or '.join(allowed)}"
        )
    return following
