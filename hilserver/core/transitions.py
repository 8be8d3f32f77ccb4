"""The state machine as a table: which state follows a command, or that it is refused.

`Control` executes the table; ``docs/reference/states.md`` prints it
(``python -m hilserver.core.transitions``).
"""

from collections.abc import Mapping
from enum import StrEnum
from typing import Final

from hilserver.errors import ControlRefused
from hilserver.signals import State


class Command(StrEnum):
    """What moves the state machine: methods first, then what the daemon does by itself."""

    START = "Start"
    PAUSE = "Pause"
    STEP = "Step"
    STOP = "Stop"
    RESET = "Reset"
    LOAD_SNAPSHOT = "LoadSnapshot"
    STARTED = "started"
    FAULT = "fault"
    END = "end"


MEANING: Final[Mapping[Command, str]] = {
    Command.START: "run on after a pause",
    Command.PAUSE: "stop the plant at the next tick; inputs and outputs stay visible",
    Command.STEP: "run n ticks, then pause again",
    Command.STOP: "emergency stop",
    Command.RESET: "acknowledge the safe state once its cause is gone; otherwise back to the start",
    Command.LOAD_SNAPSHOT: "continue from a saved state",
    Command.STARTED: "the first ticks are done",
    Command.FAULT: "stale inputs, too many overruns, a fault of the paced loop",
    Command.END: "SIGINT, SIGTERM, `--duration`",
}

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

    Raises
    ------
    ControlRefused
        If the command is refused in `state`; says in which states it works.
    """
    following = TRANSITIONS[command][state]
    if following is None:
        allowed = [s.word for s in State if TRANSITIONS[command][s] is not None]
        raise ControlRefused(
            f"{command} is not possible in state {state.word}, only in state {' or '.join(allowed)}"
        )
    return following


_HEAD = """# States of the daemon

Made from the code by `python -m hilserver.core.transitions`; a test keeps it up to date. The state
is the signal `sim.state`, the metric `hil_state` and a line of the log.

In the **safe** state the set-points ramp to zero within `plant.safe_ramp_s`, then the drive is
disabled; outputs keep being computed, with quality Uncertain. Only *Reset* ends it, and only when
its cause is gone.

Which state follows a command, by the state in which it comes ("-": refused with BadInvalidState,
and nothing changes):

"""
_TAIL = """
Commands in lower case come from the daemon itself. All other methods (`SaveSnapshot`, `SetPose`,
`Force` and so on) are possible in every state and change none.
"""


def as_markdown() -> str:
    """Return the reference page of the state machine."""
    states = " | ".join(f"{state} {state.word}" for state in State)
    rows = [
        f"| {command} | {' | '.join(s.word if s is not None else '-' for s in following)}"
        f" | {MEANING[command]} |"
        for command, following in TRANSITIONS.items()
    ]
    head = f"| command | {states} | meaning |\n|{'---|' * (len(State) + 2)}\n"
    return _HEAD + head + "\n".join(rows) + "\n" + _TAIL


if __name__ == "__main__":
    print(as_markdown(), end="")
