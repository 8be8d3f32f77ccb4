"""The methods of the server, as a table: what the address space, the checks and the docs need."""

from dataclasses import dataclass

from hilserver.signals import ValueType

STRING = "String"
"""OPC UA's String, which no signal has."""


@dataclass(frozen=True, slots=True)
class Argument:
    """One input argument of a method; `type` is an OPC UA built-in type."""

    name: str
    type: str
    description: str


@dataclass(frozen=True, slots=True)
class Method:
    """One method, node id ``s=methods.<name>``."""

    name: str
    description: str
    arguments: tuple[Argument, ...] = ()

    @property
    def node_id(self) -> str:
        """String part of the node id."""
        return f"methods.{self.name}"


_SIGNAL = Argument("signal", STRING, "Name of the signal")
_SNAPSHOT = Argument("name", STRING, "Plain file name in the snapshot directory, no path")

METHODS = (
    Method("Start", "Run on from a pause"),
    Method("Stop", "Emergency stop: go to the safe state"),
    Method("Pause", "Stop the simulation at the next tick"),
    Method(
        "Step",
        "Run exactly n ticks while paused",
        (Argument("n", ValueType.UINT32, "Number of ticks"),),
    ),
    Method("Reset", "Acknowledge the safe state; otherwise put the simulation back to its start"),
    Method("SaveSnapshot", "Save the whole state", (_SNAPSHOT,)),
    Method("LoadSnapshot", "Continue from a saved state", (_SNAPSHOT,)),
    Method(
        "Force",
        "Hold a signal at a value",
        (_SIGNAL, Argument("value", ValueType.DOUBLE, "Value in the signal's unit")),
    ),
    Method("Unforce", "Let a forced signal go", (_SIGNAL,)),
    Method(
        "InjectFault",
        "Inject a fault",
        (Argument("fault", STRING, "Description of the fault, JSON"),),
    ),
    Method("ClearFaults", "End all injected faults"),
    Method("ResetStatistics", "Start the timing figures anew"),
    Method(
        "SetPose",
        "Put the robot at a pose",
        (
            Argument("x", ValueType.DOUBLE, "Position in the world frame [m]"),
            Argument("y", ValueType.DOUBLE, "Position in the world frame [m]"),
            Argument("yaw", ValueType.DOUBLE, "Heading, counter-clockwise positive [rad]"),
        ),
    ),
    Method("AlignPose", "Put the robot where the measured one is"),
)
