"""The methods of the server, as a table: names, arguments and functions.

A new method needs a row here, and a line in ``docs/reference/opcua-address-space.md``.
"""

import re
from collections.abc import Callable
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeVar

from hilserver.signals import ValueType

if TYPE_CHECKING:  # clients also use this table, and need no compiler
    from hilserver.core.control import Control
    from hilserver.faults import Faults

T = TypeVar("T")
STRING = "String"  # OPC UA's String, which no signal has
CALLER: ContextVar[str] = ContextVar("caller", default="")
"""User of the calling session, recorded with decisions."""
_PLAIN_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,99}")


@dataclass(frozen=True, slots=True)
class Argument:
    """One input argument of a method; `type` is an OPC UA built-in type."""

    name: str
    type: str
    description: str


class Parts:
    """What the methods act on."""

    def __init__(
        self, control: "Control", faults: "Faults | None", files: Any = None
    ) -> None:
        self.control = control
        self._faults = faults
        self._files = files

    @property
    def faults(self) -> "Faults":
        """The faults; NotImplementedError if the server has none."""
        return _there(self._faults, "faults and cannot force")

    @property
    def files(self) -> Any:
        """Scenarios, recordings and patches; NotImplementedError if the server has none."""
        return _there(self._files, "scenarios, no recordings and no patches")


def _there(part: T | None, what: str) -> T:
    if part is None:
        raise NotImplementedError(f"this server has no {what}")
    return part


@dataclass(frozen=True, slots=True)
class Method:
    """One method, node id ``s=methods.<name>``."""

    name: str
    description: str
    # takes the parts and the arguments, already of their types; may be awaitable. Raises
    # ValueError for one out of range and UserError if it is not possible now
    act: Callable[..., Any]
    arguments: tuple[Argument, ...] = ()
    # called with a sentence if a call was refused, for any reason
    refused: Callable[[Parts, str], None] | None = None
    # refused while another person drives, whom it would disturb
    disturbs: bool = False

    @property
    def node_id(self) -> str:
        """String part of the node id."""
        return f"methods.{self.name}"


def _plain(name: str) -> str:
    if not _PLAIN_NAME.fullmatch(name):
        raise ValueError(
            f"{name!r:.120} is not a plain file name (letters, digits, _ . -)"
        )
    return name


def _inject(on: Parts, text: str) -> object:
    from hilserver.faults.model import parse_faults  # noqa: PLC0415 - clients need no compiler

    return on.faults.inject(*parse_faults(text))


def _undecided(on: Parts, sentence: str) -> None:
    on.files.recalibration.refused(sentence)


_SIGNAL = Argument("signal", STRING, "Name of the signal")
_SNAPSHOT = Argument(
    "name", STRING, "Plain file name in the snapshot directory, no path"
)
_SCENARIO = Argument("name", STRING, "Plain file name in folders.scenarios, no path")
_PATCH = Argument("name", STRING, "Plain file name in folders.patches, no path")
_NUMBER = Argument(
    "number", ValueType.UINT32, "Number of the proposal, see recalibration.proposal"
)
_RECORDING = Argument(
    "name", STRING, "Plain file name in folders.recordings, .mcap or .csv"
)

METHODS = (
    Method(
        "Start",
        "Resume after a pause; after Stop and Reset, let automatic sources drive",
        lambda on: on.control.start(),
        disturbs=True,
    ),
    Method(
        "Stop", "Emergency stop: go to the safe state", lambda on: on.control.stop()
    ),
    Method(
        "Pause",
        "Stop the simulation at the next tick",
        lambda on: on.control.pause(),
        disturbs=True,
    ),
    Method(
        "Step",
        "Run exactly n ticks while paused",
        lambda on, n: on.control.step(n),
        (Argument("n", ValueType.UINT32, "Number of ticks"),),
        disturbs=True,
    ),
    Method(
        "Reset",
        "Acknowledge the safe state, after which automatic sources wait for Start; otherwise"
        " return the simulation to its start",
        lambda on: on.control.reset(),
    ),
    Method(
        "SaveSnapshot",
        "Save the whole state",
        lambda on, name: on.control.save_snapshot(_plain(name)),
        (_SNAPSHOT,),
    ),
    Method(
        "LoadSnapshot",
        "Continue from a saved state",
        lambda on, name: on.control.load_snapshot(_plain(name)),
        (_SNAPSHOT,),
        disturbs=True,
    ),
    Method(
        "Force",
        "Hold a signal at a value",
        lambda on, signal, value: on.faults.force(signal, value),
        (_SIGNAL, Argument("value", ValueType.DOUBLE, "Value in the signal's unit")),
    ),
    Method(
        "Unforce",
        "Release a forced signal",
        lambda on, signal: on.faults.unforce(signal),
        (_SIGNAL,),
    ),
    Method(
        "InjectFault",
        "Inject a fault",
        _inject,
        (Argument("fault", STRING, "Description of the fault, JSON"),),
    ),
    Method("ClearFaults", "End all injected faults", lambda on: on.faults.clear()),
    Method(
        "ResetStatistics",
        "Restart the timing statistics",
        lambda on: on.control.reset_statistics(),
    ),
    Method(
        "SetPose",
        "Place the robot at a pose",
        lambda on, x, y, yaw: on.control.set_pose(x, y, yaw),
        (
            Argument("x", ValueType.DOUBLE, "Position in the world frame [m]"),
            Argument("y", ValueType.DOUBLE, "Position in the world frame [m]"),
            Argument(
                "yaw", ValueType.DOUBLE, "Heading, counter-clockwise positive [rad]"
            ),
        ),
    ),
    Method(
        "AlignPose",
        "Place the robot where the measured one is",
        lambda on: on.control.align_pose(),
    ),
    Method(
        "SetSpeed",
        "Run faster or slower than real time",
        lambda on, factor: on.control.set_speed(factor),
        (Argument("factor", ValueType.DOUBLE, "Times real time, 0.01 to 100"),),
        disturbs=True,
    ),
    Method(
        "StartScenario",
        "Play a scenario from now on",
        lambda on, name: on.files.scenarios.start(_plain(name)),
        (_SCENARIO,),
        disturbs=True,
    ),
    Method(
        "StopScenario",
        "End the scenario and all faults; set-points go to zero",
        lambda on: on.files.scenarios.stop(),
        disturbs=True,
    ),
    Method(
        "StartRecording",
        "Record into a new file",
        lambda on, name: on.files.recordings.start(_plain(name)),
        (_RECORDING,),
    ),
    Method("StopRecording", "End the recording", lambda on: on.files.recordings.stop()),
    Method(
        "LoadPatch",
        "Apply a model patch to the plant, from one tick on",
        lambda on, name: on.files.patches.load(_plain(name)),
        (_PATCH,),
    ),
    Method(
        "RemovePatch",
        "Continue without the model patch",
        lambda on: on.files.patches.remove(),
    ),
    Method(
        "SetParameter",
        "Set a parameter by a number, a name of one, or null, from one tick on",
        lambda on, name, value: on.files.patches.set_text(name, value),
        (
            Argument("name", STRING, "Name as in config.yaml"),
            Argument("value", STRING, "A number, null, or a name such as tile or true"),
        ),
    ),
    Method(
        "ResetParameters",
        "Return to the configured parameters, from one tick on",
        lambda on: on.files.patches.reset(),
    ),
    Method(
        "AcceptProposal",
        "Apply the patch of a proposal to the plant, from one tick on",
        lambda on, number: on.files.recalibration.accept(number, CALLER.get()),
        (_NUMBER,),
        _undecided,
    ),
    Method(
        "RejectProposal",
        "Reject a proposal; it is not made again",
        lambda on, number: on.files.recalibration.reject(number, CALLER.get()),
        (_NUMBER,),
        _undecided,
    ),
    Method(
        "PostponeProposal",
        "Leave a proposal open without further reminders",
        lambda on, number: on.files.recalibration.postpone(number, CALLER.get()),
        (_NUMBER,),
        _undecided,
    ),
    Method(
        "SaveParameters",
        "Save the parameters that differ from the configuration as a patch",
        lambda on, name: on.files.patches.save(_plain(name)),
        (_PATCH,),
    ),
)
METHOD_OF = {method.name: method for method in METHODS}
