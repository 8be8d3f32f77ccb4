"""Channels over time, in the stretch in which the effect shows most."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.replay.drive_stage import DriveStage
from hilserver.diagnosis.report.standalone import HEAD_HEIGHT
from hilserver.diagnosis.report.svg import Plot
from hilserver.measured.channels import SETPOINTS, SPEEDS
from hilserver.measured.data import MeasuredLog
from reference.scenarios.views.case import HEIGHT, MODELS, POINTS, Case, Legend, axes
from reference.scenarios.views.stretch import stretch

UPPER, LOWER = 280.0, 190.0
OVERLAP: Final = 20.0
"""The upper of two plots has no words below its axis, so that the lower one moves up."""


@dataclass(frozen=True, slots=True)
class OverTime:
    """A channel and its residual, where the models differ most.

    Attributes
    ----------
    words : str
        What the channel is called.
    length_s : float
        Of the stretch.
    """

    channel: str
    words: str
    length_s: float
    with_setpoint: bool = False

    def draw(self, case: Case) -> tuple[list[Plot], Legend]:
        """Draw the values above what the models leave of them."""
        s = case.series(self.channel)
        other = s.measured if s.extended is None else s.extended
        begin, end = stretch(
            case, self.channel, s.t_s, other - s.simulated, self.length_s
        )
        part = (s.t_s >= begin) & (s.t_s <= end)
        t, measured, simulated = s.t_s[part], s.measured[part], s.simulated[part]
        extended = None if s.extended is None else s.extended[part]
        curves = [("measured", measured), ("simulated", simulated)]
        rest = [("before", measured - simulated)]
        if extended is not None:
            curves.append(("extended", extended))
            rest.append(("after", measured - extended))
        legend = list(MODELS[: len(curves)])
        setpoint = (
            _steps(case.log, self.channel, begin, end) if self.with_setpoint else None
        )
        if setpoint is not None:
            legend.append(("setpoint", "set-point"))
        spans = [y for _, y in curves] + ([setpoint[1]] if setpoint is not None else [])
        above = axes(t, spans, "", f"{self.words} [{s.unit}]", UPPER, HEAD_HEIGHT)
        below = axes(
            t,
            [y for _, y in rest],
            "time [s]",
            f"residual [{s.unit}]",
            LOWER,
            HEAD_HEIGHT + UPPER - OVERLAP,
        )
        if setpoint is not None:
            above.line(*setpoint, "setpoint", "set-point", points=POINTS)
        for role, y in curves:
            above.line(t, y, role, role, points=POINTS)
        below.level(0.0)
        for role, y in rest:
            below.line(t, y, role, role, points=POINTS)
        return [above, below], legend


@dataclass(frozen=True, slots=True)
class AsRecorded:
    """A channel as it stands in the log, before any fault of the data was corrected.

    Attributes
    ----------
    at_rows : bool
        The recorded set-points are drawn too, a dot for each row.
    """

    channel: str
    words: str
    unit: str
    length_s: float
    at_rows: bool = False

    def draw(self, case: Case) -> tuple[list[Plot], Legend]:
        """Draw the log beside what the configured plant makes of its set-points."""
        channel = case.log[self.channel]
        t, simulated = self._simulated(case)
        change = np.interp(channel.t_s, t, simulated)
        weight = np.gradient(change) if self.at_rows else channel.values - change
        begin, end = stretch(case, self.channel, channel.t_s, weight, self.length_s)
        shown = (channel.t_s >= begin) & (channel.t_s <= end)
        inside = (t >= begin) & (t <= end)
        x, y = channel.t_s[shown], channel.values[shown]
        legend = [("measured", "recorded"), ("simulated", "simulated")]
        ranges = [y, simulated[inside]]
        rows = _rows(case.log, self.channel, begin, end) if self.at_rows else None
        if rows is not None:
            ranges.append(rows[1])
            legend.append(("setpoint", "recorded set-point"))
        plot = axes(
            x, ranges, "time [s]", f"{self.words} [{self.unit}]", HEIGHT, HEAD_HEIGHT
        )
        if rows is not None:
            plot.line(*rows, "setpoint", "recorded set-point", points=POINTS)
            plot.dots(*rows, "row", [f"{v:.4g} {self.unit}" for v in rows[1]])
        plot.line(x, y, "measured", "recorded", points=POINTS)
        plot.line(t[inside], simulated[inside], "simulated", "simulated", points=POINTS)
        return [plot], legend

    def _simulated(self, case: Case) -> tuple[Array, Array]:
        if self.channel not in SPEEDS:
            s = case.series(self.channel)
            return s.t_s, s.simulated
        stage = DriveStage(case.log, case.robot, block_s=5.0)
        return stage.segments.times(0), stage.simulate({})[1][
            :, SPEEDS.index(self.channel)
        ]


def _rows(
    log: MeasuredLog, channel: str, begin: float, end: float
) -> tuple[Array, Array]:
    setpoint = log[SETPOINTS[SPEEDS.index(channel)]]
    shown = (setpoint.t_s >= begin) & (setpoint.t_s <= end)
    return setpoint.t_s[shown], setpoint.values[shown]


def _steps(
    log: MeasuredLog, channel: str, begin: float, end: float
) -> tuple[Array, Array]:
    """Return the set-points of a stretch as stairs."""
    t, v = _rows(log, channel, begin, end)
    return np.repeat(t, 2)[1:], np.repeat(v, 2)[:-1]
