"""A diagnosed drive, and what draws it."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Protocol

from hilserver.arrays import Array
from hilserver.diagnosis.report.svg import Plot, span_of
from hilserver.diagnosis.schema.evidence import ChannelSeries, Diagnosis
from hilserver.measured.data import MeasuredLog
from hilserver.plant.parameters import RobotParameters

Legend = Sequence[tuple[str, str]]
MODELS: Final = (
    ("measured", "measured"),
    ("simulated", "simulated"),
    ("extended", "extended model"),
)
POINTS: Final = 600
PICTURE_WIDTH: Final = 760.0
HEIGHT: Final = 380.0


@dataclass(frozen=True)
class Case:
    """A diagnosed drive.

    Attributes
    ----------
    logs, against : tuple of MeasuredLog
        As they were recorded, one for each file.
    """

    diagnosis: Diagnosis
    robot: RobotParameters
    logs: tuple[MeasuredLog, ...]
    against: tuple[MeasuredLog, ...] = ()

    @property
    def log(self) -> MeasuredLog:
        """The first log."""
        return self.logs[0]

    def series(self, name: str) -> ChannelSeries:
        """Return a channel as the diagnosis saw it."""
        return next(s for s in self.diagnosis.evidence.series if s.name == name)


class View(Protocol):
    """Draws a case."""

    def draw(self, case: Case) -> tuple[list[Plot], Legend]:
        """Return plots below each other, the first at `HEAD_HEIGHT`, and their legend."""


def axes(
    t: Array,
    values: Sequence[Array],
    x_label: str,
    y_label: str,
    height: float,
    top: float,
) -> Plot:
    """Return a plot over the range of `t`, high enough for all values."""
    x, y = span_of(t, margin=0.0), span_of(*values)
    return Plot(x, y, x_label, y_label, width=PICTURE_WIDTH, height=height, top=top)
