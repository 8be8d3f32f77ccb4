"""A part of the daemon, a server or a link to somebody else, and what it needs of the robot."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hilserver.config.root import Config
from hilserver.core.clock import UtcClock
from hilserver.core.control import Control
from hilserver.core.events import EventBus
from hilserver.core.inputs import InputGate
from hilserver.core.parameters import LiveParameters
from hilserver.faults import Faults, Line
from hilserver.image import Frame, ProcessImage
from hilserver.io.link_status import PeerStatus
from hilserver.metrics import Source
from hilserver.plant.parameters import RobotParameters
from hilserver.ros.robot import Shape
from hilserver.signals import SignalTable


class Part:
    """What the daemon starts, shows and stops; a link overrides what it has."""

    section: str  # of the configuration; complaints name it
    label: str  # what people call it
    is_early = False  # starts before the first tick
    # what is known about who is at the other end; OPC UA, page and metrics show it
    status: PeerStatus | None = None
    metrics: Sequence[Source[Any]] = ()  # beside those of every status

    @property
    def address(self) -> str:
        """Where it is reached, or whom it reaches: its line of the banner."""
        return ""

    async def start(self) -> None:
        """Begin; who is at the other end may come later."""

    async def stop(self) -> None:
        """End, also a start that was not completed."""

    def publish(self, frame: Frame) -> object:
        """Show a frame; called by the publish slice, which does not wait."""

    def supervise(self) -> None:
        """Look after what has no event of its own; called by the supervise slice."""


Figure = float | str | bool | int | None
Table = Mapping[str, Mapping[str, Figure]]
Provider = Callable[[], Table]


@dataclass(frozen=True)
class World:
    """The robot and its daemon, as links see them."""

    config: Config
    folder: Path  # relative paths of the configuration start from it
    # ``at(section, ...)``: a context that adds the place in the file to complaints
    at: Callable[..., AbstractContextManager[None]]
    table: SignalTable
    image: ProcessImage
    gate: InputGate
    events: EventBus
    clock: UtcClock
    control: Control
    faults: Faults | None
    parameters: LiveParameters | None
    lines: Mapping[str, Line]  # where injected faults act, by the link's name
    robot: RobotParameters
    shape: Shape
    hall: Any  # float64, shape (n, 4); walls [m]
    period_ns: int
    pacing_thread: Callable[[], int]  # the system's number of it; 0 in virtual time
    # the robot as URDF, with a prefix before the names of frames and joints
    description: Callable[[str], str]
    # value, status and planned start [ns] of a signal in the newest frame
    read_output: Callable[[str], tuple[Any, int, int]]
    tables: Mapping[str, Provider]  # figures that are no signals: "slices", "peers" and "audit"
    files: Any  # starts and stops what has the name of a file
