"""A part of the daemon, a server or a link, and what it needs of the robot."""

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
from hilserver.faults import Faults, PeerLine
from hilserver.image import Frame, ProcessImage
from hilserver.io.link_status import PeerStatus
from hilserver.metrics import MetricSource
from hilserver.plant.parameters import RobotParameters
from hilserver.ros.robot import Shape
from hilserver.signals import SignalTable
from hilserver.tasks import Supervisor


class Part:
    """Started, shown and stopped by the daemon; a link overrides what applies to it."""

    section: str  # of the configuration; complaints name it
    label: str  # name for people
    is_early = False  # starts before the first tick
    # what is known about the other end; OPC UA, page and metrics show it
    status: PeerStatus | None = None
    metrics: Sequence[MetricSource[Any]] = ()  # in addition to those of every status

    @property
    def address(self) -> str:
        """Where it listens, or what it connects to: its line of the banner."""
        return ""

    async def start(self) -> None:
        """Start; the other end may appear later."""

    async def stop(self) -> None:
        """Stop, also after a start that was not completed."""

    def publish(self, frame: Frame) -> object:
        """Show a frame; called by the publish slice, which does not wait."""

    def supervise(self) -> None:
        """Check what raises no event itself; called by the supervise slice."""


Figure = float | str | bool | int | None
Table = Mapping[str, Mapping[str, Figure]]
Provider = Callable[[], Table]


@dataclass(frozen=True)
class World:
    """The robot and its daemon, for links."""

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
    lines: Mapping[str, PeerLine]  # where injected faults act, by the link's name
    robot: RobotParameters
    shape: Shape
    hall: Any  # float64, shape (n, 4); walls [m]
    period_ns: int
    pacing_thread: Callable[[], int]  # its thread id in the system; 0 in virtual time
    # the robot as URDF, with a prefix before the names of frames and joints
    description: Callable[[str], str]
    # value, status and planned start [ns] of a signal in the newest frame
    read_output: Callable[[str], tuple[Any, int, int]]
    # figures besides signals: "slices", "peers" and "audit"
    tables: Mapping[str, Provider]
    files: Any  # starts and stops what is named by a file
    tasks: Supervisor  # keeps the tasks of all links
