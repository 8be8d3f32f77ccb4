"""Measured data as all stages see them: channels with their own stamps, in segments."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from hilserver.arrays import Array, Indices
from hilserver.measured.floor_marks import PlacedMark

DIMENSIONS = {"wheel_radius_m", "track_m", "wheelbase_m"}


@dataclass(frozen=True, slots=True)
class LogSource:
    """One file of the data."""

    file: str
    sha256: str


@dataclass(frozen=True, slots=True)
class Span:
    """One segment: time rises, and the pose at its start is unknown."""

    number: int  # as in the log; numbered continuously over several logs
    block: int | None  # unit of held-out splits; None if the log names none
    # stamps of its first and last row
    start_s: float
    end_s: float
    recorded: int | None = (
        None  # number before the log was cut at pauses; None: never cut
    )

    @property
    def number_recorded(self) -> int:
        """Number that the user knows: of the log as it was recorded."""
        return self.number if self.recorded is None else self.recorded


@dataclass(frozen=True, slots=True)
class Channel:
    """The samples of one signal; every value is finite."""

    # shape (n,); stamps rise within a span
    t_s: Array
    values: Array
    span: Indices  # shape (n,); index into `MeasuredLog.spans`; does not fall

    def __len__(self) -> int:
        return len(self.t_s)

    def of(self, span: int) -> tuple[Array, Array]:
        """Return stamps and values of one span."""
        first, end = np.searchsorted(self.span, [span, span + 1])
        return self.t_s[first:end], self.values[first:end]

    def with_values(self, values: Array) -> "Channel":
        """Return the channel with other values at the same stamps."""
        return replace(self, values=values)


@dataclass(frozen=True)
class MeasuredLog:
    """Measured data of one machine, from one log or several."""

    sources: tuple[LogSource, ...]
    # by signal name of the signal table (``nav.x_m``; without ``measured.``). Wheels have the
    # plant's signs: driving forward is left > 0, right < 0
    channels: Mapping[str, Channel]
    spans: tuple[Span, ...]
    has_stamps: bool = True  # False: times were made from a rate; delays are not judged
    # keys of the plant configuration that the mapping file sets
    plant: Mapping[str, object] = field(default_factory=dict)
    # what a reader should know: rows dropped, the file ends early
    notices: tuple[str, ...] = ()
    # True: the daemon wrote the rows. All stamps are ticks of its plant, and a set-point that first
    # appears in a row came at one of the ticks since the row before
    on_ticks: bool = False
    # largest reading, of either sign, of a channel whose sensor is limited
    limits: Mapping[str, float] = field(default_factory=dict)
    # speeds that the data checks made of angles: their steps are those of a counter
    made: frozenset[str] = frozenset()
    # True: errors of its pose last for tens of seconds, as those of satellites and maps do
    pose_errors_last: bool = False
    # where the robot was at a few times, if nothing shows its pose all along
    marks: tuple[PlacedMark, ...] = ()

    @property
    def drive_is_known(self) -> bool:
        """Whether the configured process and controller are those of the log's machine.

        A mapping with the dimensions of another machine but not its process says nothing about its
        motors: every cause of the drive would be named.
        """
        return "process" in self.plant or not DIMENSIONS & set(self.plant)

    def __contains__(self, name: str) -> bool:
        return name in self.channels

    def __getitem__(self, name: str) -> Channel:
        return self.channels[name]

    def has(self, *names: str) -> bool:
        """Return whether all these signals were measured."""
        return all(name in self.channels for name in names)

    def with_channels(self, changed: Mapping[str, Channel]) -> "MeasuredLog":
        """Return the log with some channels replaced."""
        return replace(self, channels={**self.channels, **changed})

    def with_limits(self, limits: Mapping[str, float]) -> "MeasuredLog":
        """Return the log with the limits of some channels."""
        return replace(self, limits={**self.limits, **limits})

    def with_marks(self, marks: Iterable[PlacedMark]) -> "MeasuredLog":
        """Return the log with marks as its reference."""
        return replace(self, marks=tuple(marks))

    def noticed(self, *notices: str) -> "MeasuredLog":
        """Return the log with more that a reader should know."""
        return replace(self, notices=(*self.notices, *notices))

    def without(self, names: Iterable[str]) -> "MeasuredLog":
        """Return the log without some channels."""
        left_out = frozenset(names)
        kept = {name: c for name, c in self.channels.items() if name not in left_out}
        return replace(self, channels=kept)
