"""The page of the state machine."""

from collections.abc import Mapping
from typing import Final

from hilserver.core.transitions import TRANSITIONS, Command
from hilserver.signals import State

MEANING: Final[Mapping[Command, str]] = {
    Command.START: "run on after a pause; after Stop and Reset, let automatic sources drive",
    Command.PAUSE: "stop the plant at the next tick; inputs and outputs stay visible",
    Command.STEP: "run n ticks, then pause again",
    Command.STOP: "emergency stop",
    Command.RESET: "acknowledge the safe state once its cause is gone;"
    " automatic sources then wait for Start. Otherwise back to the start",
    Command.LOAD_SNAPSHOT: "continue from a saved state",
    Command.STARTED: "the first ticks are done",
    Command.FAULT: "stale inputs, too many overruns, a fault of the paced loop",
    Command.END: "SIGINT, SIGTERM, `--duration`",
}

_HEAD = """# States of the daemon

Made from the code by `make reference`; a test keeps it up to date. The state
is the signal `sim.state`, the metric `hil_state` and a line of the log.

In the **safe** state the set-points ramp to zero within `plant.safe_ramp_s`, then the drive is
disabled; outputs keep being computed, with quality Uncertain. Only *Reset* ends it, and only when
its cause is gone. Automatic sources (peer, OPC UA client, ROS 2, shield) then wait for *Start*,
unless `control.after_reset` is `continue`; the signal `control.waits_for_start` shows it, and
recordings and snapshots contain it. Hands (page, gamepad, teleop, Joy, Foxglove) drive as soon as
they were at rest. In virtual time nothing waits.

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
