"""What was measured beside both models, channel by channel, and how far they are apart."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np

from hilserver.arrays import Array, Indices
from hilserver.experiment.models import Courses
from hilserver.measured.channels import GYRO, IMU_YAW, NAV_X, NAV_Y, YAW

MEASURED: Final = "measured"
KINEMATIC: Final = "kinematic model"
MECHATRONIC: Final = "mechatronic model"
COLUMNS: Final = ("x", "y", "yaw", "turn")  # of both models
SOURCES: Final[Mapping[str, tuple[str, ...]]] = {
    "x": (NAV_X,),
    "y": (NAV_Y,),
    "yaw": (YAW, IMU_YAW, GYRO),
    "turn": (GYRO,),
}
"""The signals that show a channel, the best one first; the turn rate shows the yaw as its integral.
"""
NAMES: Final = {"x": "x", "y": "y", "yaw": "yaw", "turn": "turn rate", "place": "place"}
UNITS: Final = {"x": "m", "y": "m", "yaw": "rad", "turn": "rad/s", "place": "m"}


class Measured(NamedTuple):
    """One channel as measured; a yaw is not wrapped."""

    t_s: Array
    values: Array
    span: Indices
    signal: str


class Gap(NamedTuple):
    """How far one curve is from another."""

    channel: str
    of: str  # the curve ...
    beside: str  # ... and the one that it is compared with
    rms: float
    largest: float
    at_the_end: float
    unit: str


@dataclass(frozen=True)
class BesideModels:
    """Both models, and what was measured, by channel."""

    courses: Courses
    measured: dict[str, Measured]
    channels: tuple[str, ...]

    @property
    def models(self) -> dict[str, Array]:
        """The models by name, shape (n, 4)."""
        found = {KINEMATIC: self.courses.kinematic}
        if self.courses.mechatronic is not None:
            found[MECHATRONIC] = self.courses.mechatronic
        return found

    @property
    def place(self) -> Array | None:
        """The measured places, shape (n, 2), where x and y belong together."""
        x = self.measured.get("x")
        y = self.measured.get("y")
        if x is None or y is None or not np.array_equal(x.t_s, y.t_s):
            return None
        return np.stack([x.values, y.values], axis=1)

    def at(self, shown: Measured, model: Array) -> Array:
        """Return a curve of a model at the stamps of a measured channel."""
        return np.interp(shown.t_s, self.courses.t_s, model)

    def gaps(self) -> list[Gap]:
        """Return every model beside what was measured, and one model beside the other."""
        found = []
        if self.place is not None:
            x = self.measured["x"]
            y = self.measured["y"]
            for name, model in self.models.items():
                ahead = self.at(x, model[:, 0]) - x.values
                aside = self.at(y, model[:, 1]) - y.values
                distance = np.hypot(ahead, aside)
                found.append(gap("place", name, MEASURED, distance))
        for channel, shown in self.measured.items():
            column = COLUMNS.index(channel)
            for name, model in self.models.items():
                curve = self.at(shown, model[:, column])
                apart = curve - shown.values
                found.append(gap(channel, name, MEASURED, apart))

        if self.courses.mechatronic is not None:
            apart = self.courses.mechatronic - self.courses.kinematic
            if "x" in self.channels:
                place = np.hypot(apart[:, 0], apart[:, 1])
                found.append(gap("place", MECHATRONIC, KINEMATIC, place))
            found.append(gap("yaw", MECHATRONIC, KINEMATIC, apart[:, 2]))
        return found


def gap(channel: str, of: str, beside: str, apart: Array) -> Gap:
    """Sum up how far two curves are apart; NaN if there is nothing to compare."""
    apart = apart[np.isfinite(apart)]
    if not len(apart):
        return Gap(channel, of, beside, np.nan, np.nan, np.nan, UNITS[channel])
    size = np.abs(apart)
    rms = np.sqrt(np.mean(size * size))
    end = float(apart[-1])
    return Gap(channel, of, beside, float(rms), float(size.max()), end, UNITS[channel])


def beside_models(courses: Courses, channels: Sequence[str]) -> BesideModels:
    """Return the models beside what the recording measured of some channels."""
    found = {}
    for channel in channels:
        signal = next((name for name in SOURCES[channel] if name in courses.log), None)
        if signal is None:
            continue
        t_s, values, span = courses.of(signal)
        if channel == "yaw" and signal == GYRO:
            values = turned(t_s, values, span)
        if channel == "yaw":
            values = continuous(courses, t_s, values, span)
        found[channel] = Measured(t_s, values, span, signal)
    return BesideModels(courses, found, tuple(channels))


def turned(t_s: Array, rate: Array, span: Indices) -> Array:
    """Return the integral of a turn rate; it does not run on from span to span."""
    mean = 0.5 * (rate[1:] + rate[:-1])
    step = mean * np.diff(t_s)
    step[np.diff(span) != 0] = 0.0
    total = np.cumsum(step)
    return np.concatenate(([0.0], total))


def continuous(courses: Courses, t_s: Array, yaw: Array, span: Indices) -> Array:
    """Return a yaw without jumps, which begins each span within half a turn of the model's."""
    out = yaw.copy()
    model = np.interp(t_s, courses.t_s, courses.kinematic[:, 2])
    for number in np.unique(span):
        own = span == number
        out[own] = np.unwrap(yaw[own])
        first = int(np.argmax(own))
        turns_apart = (model[first] - out[first]) / (2.0 * np.pi)
        turns = np.rint(turns_apart)
        out[own] += 2.0 * np.pi * turns
    return out
